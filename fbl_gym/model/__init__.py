"""The rigid arm: its equations, the arms of laboratories, and arms from URDF files."""
