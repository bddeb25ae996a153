"""C and CMake texts with @names@ to fill in."""
