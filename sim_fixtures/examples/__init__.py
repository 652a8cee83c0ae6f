"""Example inputs of the simulated laboratory: facility, artifact, plans, and a run over the witness coupon."""

from sim_fixtures.examples.files import COMMITTED_SEED, ExampleFiles, example_files, write_examples

__all__ = ["COMMITTED_SEED", "ExampleFiles", "example_files", "write_examples"]
