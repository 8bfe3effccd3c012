"""The page's table of files names what is beside it, as it is, and stays one however often it is made."""

import re
from html import unescape
from urllib.parse import unquote

from mapweave.report.html import Page, list_files


def test_every_file_beside_the_page_is_linked_once_whatever_its_name(tmp_path):
    page = Page("A result")
    page.text("before")
    page.write(tmp_path / "report.html")
    names = ["landmarks.csv", "a&b.csv", 'say "no".txt', "50 %.csv", "ö#1?.tum"]
    for name in names:
        (tmp_path / name).write_text("x")
    (tmp_path / "local").mkdir()
    list_files(tmp_path)
    list_files(tmp_path)
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    links = re.findall(r'<td><a href="([^"]*)">(.*?)</a></td>', text)
    assert sorted(unquote(link) for link, _ in links) == sorted([*names, "local/"])
    assert [unescape(shown) for _, shown in links] == [unquote(link) for link, _ in links]
    assert text.count("landmarks with their covariances") == 1
    assert text.index("before") < text.index("<h2>Files</h2>") < text.index("<footer>")


def test_a_folder_without_a_page_is_left_as_it_is(tmp_path):
    (tmp_path / "a.csv").write_text("x")
    list_files(tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["a.csv"]
