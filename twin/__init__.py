"""What should be measured, how sure that is, and how the two compare."""
