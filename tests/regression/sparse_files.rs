//! A file that claims more than it holds costs neither memory nor time.
