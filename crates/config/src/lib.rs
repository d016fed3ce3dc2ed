//! Every option, typed, documented and checked in one place; Cartographer's Lua files load unchanged
