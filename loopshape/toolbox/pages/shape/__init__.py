"""The page on which a loop is shaped by hand: sessions, their data for the page, the server, a notebook's widget."""
