"""ODrive motor controllers over CAN."""
