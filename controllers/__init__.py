"""Exposure controls and the policies that pair them."""
