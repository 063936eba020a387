"""Identity of this package: its version and a hash of its source.

Results of packages with different identities are never mixed.
"""

import hashlib
from functools import cache
from importlib.metadata import version
from pathlib import Path

import rcmservo

IGNORED_FOLDERS = "cli", "live", "paper", "bringup", "page", "hardware", "figures", "recording"
"""Folders of the package that no row of a study depends on."""
IGNORED_STUDY_PARTS = "study/report", "study/execution/workers.py"
"""Parts of `study` that no row depends on."""


@cache
def identify_package() -> str:
    """Return the version of rcmservo, and 12 digits of the SHA-256 of all files that rows need."""
    root, digest = Path(rcmservo.__file__).parent, hashlib.sha256()
    for path in sorted((*root.rglob("*.py"), *root.rglob("*.toml"))):
        name = path.relative_to(root).as_posix()
        is_ignored = name.partition("/")[0] in IGNORED_FOLDERS
        if not is_ignored and not name.startswith(IGNORED_STUDY_PARTS):
            digest.update(name.encode() + b"\0" + path.read_bytes() + b"\0")
    return f"{version('rcmservo')} {digest.hexdigest()[:12]}"
