//! A limb that is cut off is left out, or its joints state how uncertain they are.
