"""Worker processes that may die, and folders that one job at a time may write."""
