"""How good a design is: cost, margins and errors, beside LQR and the optimum."""
