"""The operator's windows: no science and no device input or output of their own."""
