"""The gallery shows pictures that are there, light, under the commands that make them."""

import gallery
from PIL import Image


def test_the_page_is_the_one_that_the_commands_were_taken_from():
    assert gallery.PAGE.read_text(encoding="utf-8") == gallery.page()


def test_every_picture_is_there_and_all_of_them_are_light():
    files = sorted(gallery.PICTURES.iterdir())
    assert files == sorted(p.image for p in gallery.GALLERY)
    assert sum(f.stat().st_size for f in files) < 1_500_000


def test_a_picture_is_made_narrow_and_keeps_its_shape(tmp_path):
    Image.linear_gradient("L").resize((1800, 600)).convert("RGB").save(tmp_path / "wide.png")
    gallery.lighten(tmp_path / "wide.png", tmp_path / "light.png")
    with Image.open(tmp_path / "light.png") as image:
        assert image.size == (900, 300)
        assert image.mode == "P"
