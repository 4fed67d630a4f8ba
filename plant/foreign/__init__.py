"""What foreign files need before and around the libraries that parse them: clean text, and a process to die in."""
