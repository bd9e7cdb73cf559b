"""What things cost as scenes, views and pictures grow."""
