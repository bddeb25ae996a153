"""The sampled loop, proved again in Arb balls."""
