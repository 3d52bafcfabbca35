"""What runs hold of a shaft's torque: settled levels, drag over speed, cogging, the torque at which it lets go."""
