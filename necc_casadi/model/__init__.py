"""Plant, controller and their closed loop (eq. Plant … ClosedLoopSystem), from a user's file."""
