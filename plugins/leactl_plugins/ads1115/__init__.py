"""ADS1115 analog-to-digital converter over I2C."""
