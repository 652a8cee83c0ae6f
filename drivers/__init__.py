"""How each device is spoken to, byte by byte."""
