"""Black boxes that are stepped from outside: Python step functions and programs that talk over a pipe."""
