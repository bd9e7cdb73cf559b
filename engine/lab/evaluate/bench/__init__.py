"""What `mark3dgs bench` measures: a table of benches (`benches`) and the functions of their cells."""
