//! The header is that of the source.

use std::path::Path;

#[test]
fn the_header_is_current() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut written = Vec::new();
    cbindgen::generate(folder).unwrap().write(&mut written);
    let written = String::from_utf8(written).unwrap();
    let header = folder.join("include/snake_rs.h");
    if std::env::var_os("SNAKE_WRITE_HEADER").is_some() {
        std::fs::write(&header, &written).unwrap();
    }
    let committed = std::fs::read_to_string(&header).unwrap();
    assert!(
        committed == written,
        "the header is old: SNAKE_WRITE_HEADER=1 cargo test --release -p snake-capi --test header"
    );
}
