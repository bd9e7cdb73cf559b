"""What is shown to people: claims, checks and disputes in words, numbers as they are read, pages and maps."""
