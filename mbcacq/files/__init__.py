"""Files at the edges of the program: tables that enter, read by one reader, and files that leave, written whole."""
