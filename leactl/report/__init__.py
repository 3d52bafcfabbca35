"""Results for people to read: tables and plots in the terminal; numbers come from leactl.analysis as they are."""
