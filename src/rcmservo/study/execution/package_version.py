"""What this package is known by: its version, and a hash of its source. Results of another one are
not mixed with its own.
"""

import hashlib
from functools import cache
from importlib.metadata import version
from pathlib import Path

import rcmservo

UNRELATED = (
    "cli",
    "live",
    "paper",
    "bringup",
    "page",
    "hardware",
    "figures",
    "recording",
)
"""Folders that no row depends on."""
TOLD = "study/report", "study/execution/workers.py"
"""Parts of a study that no row depends on."""


@cache
def package() -> str:
    """The version of rcmservo, and the first digits of the SHA-256 of what rows depend on."""
    root, text = Path(rcmservo.__file__).parent, hashlib.sha256()
    for path in sorted((*root.rglob("*.py"), *root.rglob("*.toml"))):
        name = path.relative_to(root).as_posix()
        if name.partition("/")[0] not in UNRELATED and not name.startswith(TOLD):
            text.update(name.encode() + b"\0" + path.read_bytes() + b"\0")
    return f"{version('rcmservo')} {text.hexdigest()[:12]}"
