"""What pyproject.toml cannot say: the README as the package index shows it, where relative links lead nowhere.

CLOAK_URL names the repository (https://HOST/OWNER/NAME), to which the links then lead; without it they are plain words.
"""

import os
import re
from pathlib import Path

from setuptools import setup

LINK = re.compile(r"(!?)\[([^\]]*)\]\((?!https?:|#)([^)\s]+)\)")
URLS = {"Paper": "https://arxiv.org/abs/2104.11101"}


def index_readme(text: str, url: str | None) -> str:
    """The README with links and pictures of the repository at `url`, or with neither where there is none."""

    def absolute(found: re.Match[str]) -> str:
        mark, words, path = found.groups()
        if url is None:
            return "" if mark else words
        return f"{mark}[{words}]({url}/{'raw' if mark else 'blob'}/HEAD/{path})"

    return LINK.sub(absolute, text)


def index_urls(url: str | None) -> dict[str, str]:
    """The links beside the README."""
    if url is None:
        return URLS
    return URLS | {"Repository": url, "Changes": f"{url}/blob/HEAD/CHANGELOG.md", "Issues": f"{url}/issues"}


if __name__ == "__main__":
    repository = os.environ.get("CLOAK_URL", "").rstrip("/") or None
    setup(
        long_description=index_readme(Path("README.md").read_text("utf-8"), repository),
        long_description_content_type="text/markdown",
        project_urls=index_urls(repository),
    )
