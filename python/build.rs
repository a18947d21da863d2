//! On macOS an extension module is linked before Python is there. Maturin says so to the linker; Cargo alone needs this.

fn main() {
    pyo3_build_config::add_extension_module_link_args();
}
