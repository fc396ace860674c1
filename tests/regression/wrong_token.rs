//! A wrong token brings the form back, with the reason.
