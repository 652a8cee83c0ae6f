"""Designing an artifact: its reflective pattern, what of it can be measured, and what a scan of it could tell apart."""
