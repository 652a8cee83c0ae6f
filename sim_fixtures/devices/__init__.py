"""Device simulators on real wires: one module a wire protocol, written from the protocol's own documents."""
