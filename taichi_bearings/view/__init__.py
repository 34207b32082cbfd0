"""One page that turns in the browser: what it holds, and the file."""
