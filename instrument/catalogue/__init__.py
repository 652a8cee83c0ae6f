"""What runs there are: a catalogue that can be made again from the run folders at any time (``docs/records.md``)."""
