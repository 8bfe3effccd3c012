"""The description that a wheel carries: README.md without what leads into the repository: it is read elsewhere."""

import re
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface

PICTURE = re.compile(r"^!\[[^\]]*\]\((?!https?:)[^)]*\)\n+", re.MULTILINE)
LINK = re.compile(r"\[([^\]]+)\]\((?!https?:)[^)]*\)")
COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)


def description(readme: str) -> str:
    """Its text: no pictures of the repository, words instead of links into it, no comments."""
    return COMMENT.sub("", LINK.sub(r"\1", PICTURE.sub("", readme)))


class LongDescription(MetadataHookInterface):
    """Gives hatchling the description when it builds."""

    def update(self, metadata: dict[str, Any]) -> None:
        text = description(Path(self.root, "README.md").read_text(encoding="utf-8"))
        metadata["readme"] = {"content-type": "text/markdown", "text": text}
