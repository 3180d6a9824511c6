"""The recording: the only room that knows MCAP."""
