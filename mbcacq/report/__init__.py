"""The report: one self-contained HTML page with the accuracy of a calibrated cell and its causes."""
