"""Calibration as procedures: each runs on the devices of a scan, and leaves a dated result (docs/calibration.md)."""
