//! Text from outside cannot forge lines or reorder text on terminals, in logs and in CSV.
