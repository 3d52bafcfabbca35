"""Operating points of two coupled actuators, what power goes in and out there, and contours over them."""
