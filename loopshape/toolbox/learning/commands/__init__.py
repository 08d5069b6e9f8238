"""Commands of feedforward and learning."""
