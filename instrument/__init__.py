"""What a scan is: plan, states, safety, calibration, uncertainty, records."""
