//! The public API of Portolan in one crate
