"""From radiance to the 8-bit picture: an EMVA 1288 sensor."""
