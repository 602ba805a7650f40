"""Other agents on the same protocol, to compare with."""
