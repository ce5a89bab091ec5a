"""Metadata of the package, from one URL: its links, and a README for the index."""

import re
from pathlib import Path

from hatchling.metadata.plugin.interface import MetadataHookInterface

LINK = re.compile(r"(!?)\[([^\]]*)\]\((?!https?:|#)([^)\s]+)\)")
"""A link or a picture within the repository."""

PICTURE = re.compile(r"<picture>.*?</picture>\n*", flags=re.S)
"""A picture with a form for dark pages."""


def readme(text: str, url: str, tag: str) -> str:
    """Return the README with absolute links and a badge; without a URL, with words alone."""

    def absolute(link: re.Match[str]) -> str:
        picture, words, path = link.groups()
        if not url:
            return "" if picture else words
        return f"{picture}[{words}]({url}/{'raw' if picture else 'blob'}/{tag}/{path})"

    text = LINK.sub(absolute, text)
    text = re.sub(r'(src|srcset)="(?!https?:)', rf'\1="{url}/raw/{tag}/', text) if url else PICTURE.sub("", text)
    badge = f"[![tests]({url}/actions/workflows/test.yml/badge.svg)]({url}/actions/workflows/test.yml)"
    return text.replace("\n\n", f"\n\n{badge}\n\n", 1) if url else text


def links(url: str, tag: str) -> dict[str, str]:
    """Return the project's links; the documentation is that of the repository's pages on GitHub."""
    paper = {"Paper": "https://doi.org/10.1080/23311916.2016.1173529"}
    if not url:
        return paper
    owner, name = url.split("/")[-2:]
    changes = f"{url}/blob/{tag}/CHANGELOG.md"
    pages = f"https://{owner}.github.io/{name}/"
    return {"Source": url, "Documentation": pages, "Issues": f"{url}/issues", "Changelog": changes, **paper}


class Links(MetadataHookInterface):
    """Hatchling calls it when it builds or installs the package."""

    def update(self, metadata: dict) -> None:
        """Set the readme and the URLs."""
        url, tag = self.config["url"].rstrip("/"), f"v{metadata['version']}"
        text = (Path(self.root) / "README.md").read_text(encoding="utf-8")
        metadata["readme"] = {"content-type": "text/markdown", "text": readme(text, url, tag)}
        metadata["urls"] = links(url, tag)
