"""What the compiled code was made of.

numba keeps compiled functions on disk and looks only at the file of the function it is asked for,
not at the files of the functions that it calls. A digest of this folder, closed over by the
outermost function, makes any change here compile it anew.
"""

from __future__ import annotations

import hashlib
from pathlib import Path


def digest() -> str:
    """A hash of all source files of this package."""
    total = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("*.py")):
        total.update(path.read_bytes())
    return total.hexdigest()
