"""A laboratory without hardware: device simulators on real wires and a simulated reality."""
