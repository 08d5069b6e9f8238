"""Feedforward, iterative and repetitive learning: a measured plant comes in, taps or a filter go out.

The next trial's feedforward is learned from recordings.
"""
