"""What is proved about a finished design: claims, their prover, and an independent checker."""
