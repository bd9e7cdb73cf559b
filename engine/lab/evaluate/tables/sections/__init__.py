"""What the tables say: one module a table or figure, with the cells it needs and the section it makes of their rows."""
