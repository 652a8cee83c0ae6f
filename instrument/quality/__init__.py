"""Quality of what is measured: outliers, drift within a burst, slopes, coverage, several runs of one sample."""
