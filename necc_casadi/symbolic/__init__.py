"""Exact answers about expressions; knows no plant.

What a file may know grows from line to line::

    expressions identifiers floats   text, names and floats of expressions
    fold derivatives primitive       one walk; slopes; antiderivatives
    zero                             is it zero, which sign
    finite_field modular arb         values over GF(p), matrices of them; values in balls
    linear_algebra semidefinite      rank, kernel; ⪰ 0 for all states
    gains                            dissipation as a sum of gains, and their factors
    definiteness observability       of constant matrices: which kind, by which direction

`semidefinite` stays apart from `definiteness`, because the certificate's checker trusts the first
and needs nothing of the second, in which floating point proposes. `modular` stays apart from
`finite_field`, because it knows residues and no expression.
"""
