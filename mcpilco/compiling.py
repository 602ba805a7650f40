"""A fingerprint of the source of compiled code.

numba keeps compiled functions on disk and looks only at the file of the function it is asked for,
not at the files of the functions that it calls. A digest of their folders, closed over by the
outermost function, makes any change there compile it anew.
"""

from __future__ import annotations

import hashlib
from pathlib import Path


def digest(*packages: str | Path) -> str:
    """A hash of all source files of some packages of mcpilco, or of other folders.

    Packages are such as `search/fused`, relative to mcpilco, or absolute.

    Raises:
        FileNotFoundError: a folder has no source file.
    """
    total = hashlib.sha256()
    for package in packages:
        paths = sorted((Path(__file__).parent / package).glob("*.py"))
        if not paths:
            raise FileNotFoundError(
                f"A digest is of folders with Python files, and {package} has none; name those "
                "that the compiled code is made of."
            )
        for path in paths:
            total.update(path.read_bytes())
    return total.hexdigest()
