//! A take that is removed, renamed, truncated or unmounted while it is recorded is reported.
