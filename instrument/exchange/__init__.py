"""Measurements in the forms of others, and theirs in ours (``docs/exchange.md``)."""
