"""What closes the loop: blocks, controllers, fixed systems, schedules, and the loops that follow from them."""
