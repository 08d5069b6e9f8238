"""MuJoCo models and FMUs as machines, and the fix to take home."""
