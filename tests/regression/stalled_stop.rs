//! A take that is stopped in a stall does not contradict itself.
