"""Parameter sets of actuators and the quantities that follow from them."""
