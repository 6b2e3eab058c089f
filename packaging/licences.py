"""Write debian/copyright from what the wheels say: `licences.py SITE_PACKAGES FINAL_PATH OUT`."""

import email.message
import email.parser
import sys
from collections.abc import Iterator
from pathlib import Path

_HEAD = """\
Format: https://www.debian.org/doc/packaging-manuals/copyright-format/1.0/
Upstream-Name: vcu-gateway
Comment:
 The package holds, unchanged, the published wheels of the libraries that the
 program was tested with. The whole text of each one's licence stands in its
 folder {site}/NAME-VERSION.dist-info/.

Files: *
Copyright: 2026 the authors of vcu-gateway
License: Apache-2.0
"""

# A library inside our own wheel.
_UPLOT = """\
Files: {where}/vcu_gateway/export/uplot/*
Copyright: 2022 Leon Sorokin
License: Expat
Comment: uPlot 1.6.32, unchanged; its licence stands beside it
"""

# The names of Debian, of SPDX and of the wheels whose metadata name no version.
_NAMES = {"MIT": "Expat", "LGPL-3.0-only": "LGPL-3", "PSF-2.0": "Python-2.0", "BSD": "BSD-2-Clause"}
_CLASSIFIER = "License :: OSI Approved :: MIT License"

_COMMON = {
    "Apache-2.0": "/usr/share/common-licenses/Apache-2.0",
    "LGPL-3": "/usr/share/common-licenses/LGPL-3",
}


def main(site: Path, final: str, out: Path) -> None:
    """One paragraph a wheel, one a licence."""
    folders = sorted(site.glob("*.dist-info"))
    bundled = {folder: _metadata(folder) for folder in folders if not _is_ours(folder)}
    paragraphs = [_HEAD.format(site=final)]
    paragraphs.append(_UPLOT.format(where=final.lstrip("/")))
    paragraphs += [_paragraph(folder, wheel, final) for folder, wheel in bundled.items()]
    named = {name for wheel in bundled.values() for name in _single(_licence(wheel))}
    paragraphs += [_text(name, final) for name in sorted(named | {"Apache-2.0", "Expat"})]
    out.write_text("\n".join(paragraphs), encoding="utf-8")


def _is_ours(folder: Path) -> bool:
    return folder.name.startswith("vcu_gateway-")


def _metadata(folder: Path) -> email.message.Message:
    text = (folder / "METADATA").read_text(encoding="utf-8")
    return email.parser.HeaderParser().parsestr(text)


def _licence(wheel: email.message.Message) -> str:
    said = wheel["License-Expression"] or wheel["License"]
    if said is None and _CLASSIFIER in wheel.get_all("Classifier", []):
        said = "MIT"
    if said is None or "\n" in said:
        raise SystemExit(f"error: {wheel['Name']} names no licence in its metadata")
    words = {"OR": "or", "AND": "and"} | _NAMES
    return " ".join(words.get(word, word) for word in said.split())


def _single(licence: str) -> Iterator[str]:
    yield from (word for word in licence.split() if word not in ("or", "and"))


def _paragraph(folder: Path, wheel: email.message.Message, final: str) -> str:
    where = final.lstrip("/")
    files = "".join(f"\n {where}/{name}" for name in _tops(folder))
    return (
        f"Files:{files}\n"
        f"Copyright: the authors of {wheel['Name']}, as its licence says\n"
        f"License: {_licence(wheel)}\n"
        f"Comment: {wheel['Name']} {wheel['Version']}, {wheel['Summary']}\n"
    )


def _tops(folder: Path) -> list[str]:
    """The folders and files of a wheel, as patterns."""
    lines = (folder / "RECORD").read_text(encoding="utf-8").splitlines()
    paths = [line.split(",")[0].split("/") for line in lines]
    return sorted({path[0] + ("/*" if len(path) > 1 else "") for path in paths})


def _text(name: str, final: str) -> str:
    where = _COMMON.get(name)
    if where:
        return f"License: {name}\n The whole text stands in {where}.\n"
    return f"License: {name}\n The whole text stands in {final}/*.dist-info/.\n"


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2], Path(sys.argv[3]))
