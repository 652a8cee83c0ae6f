"""Why measurement and simulation differ: whether, where, which effect, and how far the gap shrinks."""
