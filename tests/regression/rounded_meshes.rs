//! Closed meshes with rounded or coincident vertices are accepted.
