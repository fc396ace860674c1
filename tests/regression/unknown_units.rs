//! A unit that is unknown or misspelt is never taken for millimetres.
