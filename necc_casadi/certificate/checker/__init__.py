"""The independent checker, in Arb balls: it loads nothing of the prover, and no CasADi."""
