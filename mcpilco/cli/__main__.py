"""`python -m mcpilco.cli` is the command `mcpilco`."""

import sys

from mcpilco.cli import main

sys.exit(main())
