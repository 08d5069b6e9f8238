"""The pneumatic muscle arm (van den Brink, DCT 2007.002): its numbers, its simulation, its demo.

An experiment comes in, a recording goes out; the gap toolbox follows it through `effect`.
"""
