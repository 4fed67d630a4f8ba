"""How a response and a table show themselves: words and HTML, a pandas frame, a Bode plot and its style."""
