"""Other agents on the same protocol: nothing here yet."""
