"""What a page does in headless Chromium, where this machine has one."""

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
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)  # noqa: S603
    assert "CONSOLE" not in done.stderr
    found = re.search(r'data-seen="([^"]*)"', done.stdout)
    assert found, "the page came to no end"
    return json.loads(found[1].replace("&quot;", '"'))
