//! A take keeps its health and how it ended, whatever is recorded after it.
