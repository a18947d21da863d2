//! Nothing: the tests and the examples beside this file need features and crates that no program of snake-rs has. As a package of their
//! own they do not change what `make test` compiles.
