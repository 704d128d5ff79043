"""Where the content of a report comes from: results, run folders, diagnoses."""
