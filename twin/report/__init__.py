"""The report of a run or of a comparison: the counterpart of every result figure and table of the paper, and what they
rest on."""
