"""Study: tables 1 to 6 and figures 6 and 7 of the paper on our scenes, and what each stage buys."""
