"""What `mark3dgs bench` measures: a table of benches (`table`) and the functions of their cells."""
