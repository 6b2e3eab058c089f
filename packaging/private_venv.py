"""Make a folder of installed wheels ready to ship: `private_venv.py SITE_PACKAGES FINAL_PATH`.

To be run by the Python that will run it. Takes away what depends on the building machine and the
command line tools of libraries, and compiles everything for the final path. Nothing is compiled
on the vehicle, where the file system may be read-only; nor is a source's time ever compared.
"""

import compileall
import csv
import io
import shutil
import sys
from pathlib import Path
from py_compile import PycInvalidationMode

_OF_THIS_MACHINE = ("direct_url.json", "REQUESTED", "uv_cache.json", "uv_build.json")
_SOURCES_OF_BINARIES = (".c", ".h", ".pyx", ".pxd")


def main(site: Path, final: str) -> None:
    """Trim and compile; SystemExit where a module cannot be compiled."""
    _trim(site)
    for record in site.glob("*.dist-info/RECORD"):
        _forget_what_is_gone(record, site)
    done = compileall.compile_dir(
        site,
        maxlevels=50,
        quiet=1,
        workers=1,
        stripdir=str(site),
        prependdir=final,
        optimize=0,
        invalidation_mode=PycInvalidationMode.UNCHECKED_HASH,
    )
    if not done:
        raise SystemExit("error: not every module could be compiled")


def _trim(site: Path) -> None:
    shutil.rmtree(site / "bin", ignore_errors=True)
    (site / ".lock").unlink(missing_ok=True)
    for folder in [path for path in site.rglob("__pycache__") if path.is_dir()]:
        shutil.rmtree(folder)
    for path in [path for path in site.rglob("*") if path.is_file()]:
        if path.name in _OF_THIS_MACHINE or path.suffix in _SOURCES_OF_BINARIES:
            path.unlink()


def _forget_what_is_gone(record: Path, site: Path) -> None:
    rows = csv.reader(io.StringIO(record.read_text(encoding="utf-8")))
    kept = io.StringIO()
    csv.writer(kept, lineterminator="\n").writerows(
        sorted(row for row in rows if (site / row[0]).is_file())
    )
    record.write_text(kept.getvalue(), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
