"""The page on which a loop is shaped by hand: `payload` has its data, `page` makes the file; TypeScript in `src`."""
