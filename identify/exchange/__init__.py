"""Reading and writing admittances in other tools' formats."""
