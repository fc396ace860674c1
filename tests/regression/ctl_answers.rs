//! Answers of `ctl` and `config check` name what is so.
