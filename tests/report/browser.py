"""What a page does in headless Chromium, where this machine has one."""

import importlib.resources
import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
OPTIONS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking", "--no-first-run",
    "--disable-sync", "--enable-logging=stderr", "--virtual-time-budget=4000", "--dump-dom",
)  # fmt: skip


def seen_in_browser(html: str, home: Path, width: int, *, dark: bool) -> Any:
    """What the page put into `dataset.seen` of its root, as JSON; nothing was said on the console."""
    (home / "page.html").write_text(html, encoding="utf-8")
    command = [str(CHROMIUM), *OPTIONS, f"--user-data-dir={home / 'user'}", f"--window-size={width},900"]
    command += ["--force-dark-mode"] * dark + [(home / "page.html").as_uri()]
    for _ in range(2):  # what a page says it says each time; the browser itself, on a busy machine, now and then
        done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)  # noqa: S603
        said = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
        if not said:
            break
    assert not said, said
    found = re.search(r'data-seen="([^"]*)"', done.stdout)
    assert found, "the page came to no end"
    return json.loads(found[1].replace("&quot;", '"'))


def found_by_axe(html: str, home: Path, width: int, *, dark: bool) -> list[str]:
    """What axe finds that keeps somebody from using the page: the rule, and the first element that breaks it."""
    axe = (importlib.resources.files("axe_core_python") / "axe.min.js").read_text(encoding="utf-8")
    asks = (
        "window.addEventListener('load', () => axe.run().then((made) => { document.documentElement.dataset.seen = "
        "JSON.stringify(made.violations.map((one) => [one.id, one.nodes[0].target.join(' ')].join(': '))); }));"
    )
    watched = html.replace("</body>", f"<script>{axe}</script><script>{asks}</script></body>")
    return list(seen_in_browser(watched, home, width, dark=dark))
