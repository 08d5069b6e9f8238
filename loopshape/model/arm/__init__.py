"""The pneumatic muscle arm (van den Brink, DCT 2007.002)."""
