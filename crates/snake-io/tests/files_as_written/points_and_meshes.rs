//! PLY, PCD and meshes.

use super::*;

#[test]
fn ascii_ply_whose_other_values_do_not_fit_their_types() {
    let file = |properties: &str, rest: &str| {
        format!(
            "ply\nformat ascii 1.0\nelement vertex 6\n{PLY_AXES}{properties}end_header\n{}",
            rows(" ", &format!(" {rest}\n"))
        )
    };
    assert_read(
        "ply",
        [
            file("property uchar red\n", "255.0"),
            file("property uchar red\n", "256"),
            file("property uchar red\n", "-1"),
            file("property uchar red\n", "nan"),
            file("property int label\n", "1e3"),
            file("property uint label\n", "-1"),
            file("property int64 time\n", "1630450000000000000"),
            file("property string name\n", "roof"),
            file("property list uchar int scalar_(0.1)\n", "2 7 x"),
            file("property float x2\nproperty float x2\n", "1 2"),
            file("", "1 2 3"),
            file("comment property float x\nobj_info num_cols 6\n\n", ""),
            file("", "") + "\0\0\n\x1a\n",
        ],
    );
    // All digits are kept, whatever the type.
    let text = format!(
        "ply\nformat ascii 1.0\nelement vertex 2\n{PLY_AXES}end_header\n691000.25 5336000.5 512\n691001.375 5336001.0625 512\n"
    );
    let cloud = parse_cloud(text.as_bytes(), PointFormat::Ply, &ReadOptions::default()).unwrap();
    assert_eq!(snake_core::add_origin(cloud.points[1], cloud.origin), [691_001.375, 5_336_001.062_5, 512.0]);
    assert_refused(
        "ply",
        [(file("", "").replace("vertex 6", "vertex 5"), "follows the last row that the header promises")],
    );
    assert_refused("ply", [(file("property uchar red\n", ""), "does not fit the properties of `vertex`")]);
}

#[test]
fn ply_with_the_line_ends_of_every_system() {
    let lines = [
        "ply",
        "format FORMAT 1.0",
        "comment \u{e9} by hand",
        "element vertex 6",
        "property  float x ",
        "property float y",
        "property float z",
        "end_header",
        "",
    ];
    let first = POINTS.map(|[_, y, z]| [f32::from_le_bytes(*b"\n\r\n?"), y, z]);
    for end in ["\n", "\r\n", "\r", "\n\r"] {
        let header = |format: &str| lines.join(end).replace("FORMAT", format);
        let binary = [header("binary_little_endian").as_bytes(), &floats(POINTS.as_flattened())].concat();
        let latin: Vec<u8> = header("ascii").chars().map(|c| c as u8).chain(rows(" ", end).bytes()).collect();
        assert_read(
            "ply",
            [header("ascii") + &rows(" ", end), format!("\u{feff}{}{end}{end}{}", header("ascii"), rows("  ", end))],
        );
        assert_read("ply", [binary, latin]);
        let hard = [header("binary_little_endian").as_bytes(), &floats(first.as_flattened())].concat();
        if end != "\n\r" {
            assert_eq!(read("ply", &hard).unwrap(), first, "{end:?}");
        }
    }
}

#[test]
fn binary_ply_with_elements_and_lists_in_any_order() {
    let row = |[x, y, z]: Point, tail: &[u8]| [&[2_u8, 7, 0, 8, 0][..], &floats(&[x, y, z]), tail].concat();
    let head = "ply\nformat binary_little_endian 1.0\n";
    let list = format!("property list uchar short ring\n{PLY_AXES}");
    let body = |tail: &[u8]| POINTS.iter().flat_map(|&point| row(point, tail)).collect::<Vec<u8>>();
    let face = [&[3_u8][..], &[0_u32, 1, 2].map(u32::to_le_bytes).concat()].concat();
    let faces_first =
        format!("{head}element face 1\nproperty list uchar uint vertex_indices\nelement vertex 6\n{list}end_header\n");
    let wide = format!("{head}element vertex 6\n{list}property int64 time\nproperty float16 i\nend_header\n");
    assert_read(
        "ply",
        [[faces_first.as_bytes(), &face, &body(&[])].concat(), [wide.as_bytes(), &body(&[1; 10])].concat()],
    );
    let plain = format!("{head}element vertex 6\n{PLY_AXES}property uchar red\n");
    let vertices =
        |extra: usize| POINTS.iter().flat_map(|point| [floats(point), vec![7; extra]].concat()).collect::<Vec<u8>>();
    let faces = "element face 1\nproperty list uchar uint vertex_index\n";
    // Bytes after the data, fewer than points or zero, and faces that are cut short.
    assert_read(
        "ply",
        [
            [format!("{plain}end_header\n").as_bytes(), &vertices(1), b"\r\n"].concat(),
            [format!("{plain}end_header\n").as_bytes(), &vertices(1), &[0; 70]].concat(),
            [format!("{plain}{faces}end_header\n").as_bytes(), &vertices(1), &face].concat(),
            [format!("{plain}{faces}end_header\n").as_bytes(), &vertices(1), &face[..9]].concat(),
        ],
    );
    // A type in the header that is not the one of the data.
    assert_refused(
        "ply",
        [
            (
                [format!("{plain}end_header\n").as_bytes(), &vertices(4)].concat(),
                "18 bytes are left over after 6 points",
            ),
            ([format!("{plain}{faces}end_header\n").as_bytes(), &vertices(4), &face].concat(), "does not fit the data"),
            (
                format!("{head}element vertex 1\n{PLY_AXES}property long t\nend_header\n").into_bytes(),
                "unknown type `long`",
            ),
            (
                format!("{head}element chunk 0\nelement vertex 1\nproperty uint packed_position\nend_header\n")
                    .into_bytes(),
                "splat-transform",
            ),
            (
                format!("{head}element point 0\nend_header\n").into_bytes(),
                "no element `vertex`; the elements are point",
            ),
        ],
    );
}

#[test]
fn strips_of_triangles_are_sampled() {
    let text = format!(
        "ply\nformat ascii 1.0\nelement vertex 6\n{PLY_AXES}element tristrips 1\nproperty list int int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n1 1 0\n5 0 0\n5 1 0\n8 0 1 2 3 -1 0 1 2\n"
    );
    let drawn = read_with("ply", text.as_bytes(), &ReadOptions::default().with_sample(Some(200))).unwrap();
    assert!(
        drawn.len() == 200
            && drawn.iter().all(|p| p[0] <= 1.0 && p[2] == 0.0)
            && drawn.iter().any(|p| p[0] + p[1] > 1.1)
    );
    assert_eq!(read("ply", text.as_bytes()).unwrap().len(), 6);
}

#[test]
fn pcd_of_other_systems() {
    for end in ["\n", "\r\n", "\r", "\n\r"] {
        let header = |data: &str| {
            [
                "# .PCD \u{e9}",
                "VERSION .7",
                "FIELDS x y z _",
                "SIZE 4 4 4 1",
                "TYPE F F F ?",
                "COUNT 1 1 1 3",
                "WIDTH 6",
                "HEIGHT 1",
                data,
                "",
            ]
            .join(end)
        };
        let body = POINTS.iter().flat_map(|point| [floats(point), vec![9; 3]].concat()).collect::<Vec<u8>>();
        assert_read(
            "pcd",
            [
                (header("DATA ascii") + &rows("\t", &format!(" 1 x 2 {end}"))).into_bytes(),
                format!("\u{feff}{}{}\0\0", header("DATA ascii"), rows(" ", &format!(" a b c{end}"))).into_bytes(),
                [header("DATA binary").as_bytes(), &body].concat(),
                [header("DATA binary").as_bytes(), &body, &[0; 99]].concat(),
            ],
        );
        assert_refused("pcd", [([header("DATA binary").as_bytes(), &body, &[1; 6]].concat(), "6 bytes are left over")]);
    }
}

#[test]
fn meshes_of_other_systems() {
    for end in ["\n", "\r\n", "\r", "\n\r"] {
        let vertices: String = POINTS.iter().map(|p| format!("v {} {} \\{end} {}#{end}", p[0], p[1], p[2])).collect();
        assert_read(
            "obj",
            [
                format!("\u{feff}{vertices}f 1 2 3 # a comment{end}f 1 \\{end}2 3{end}"),
                format!("# C:\\models\\{end}{vertices}f 1//1 2//2 3//3 \\{end}"),
            ],
        );
        let triangles = POINTS.chunks(3).map(|corners| {
            let vertex = |p: &Point| format!("vertex {} {}{end} {} ", p[0], p[1], p[2]);
            format!("facet normal 0 0 1 outer loop {}endloop endfacet ", corners.iter().map(vertex).collect::<String>())
        });
        let triangles: String = triangles.collect();
        assert_read(
            "stl",
            [
                format!("solid a vertex {end}{triangles}endsolid a vertex 1"),
                format!("\u{feff}SOLID b {triangles} ENDSOLID"),
                format!("solid{end}{triangles}{end}endsolid{end}; written by vertex 1 2{end}{end}\0\0\x1a"),
            ],
        );
        let body = rows(" ", end);
        assert_read(
            "off",
            [
                format!("\u{feff}OFF{end}6 1 0{end}{body}3 0 1 2{end}"),
                format!("off # by hand{end}6 1{end}{body}3 0 1 2 255 0 0"),
            ],
        );
    }
    let binary = |count: u32, triangles: usize, tail: &[u8]| {
        let triangle = |corners: &[Point]| [vec![0; 12], floats(corners.as_flattened()), vec![0; 2]].concat();
        let all = POINTS.chunks(3).cycle().take(triangles).flat_map(triangle).collect::<Vec<u8>>();
        [format!("{:80}", "solid by CAD").as_bytes(), &count.to_le_bytes(), &all, tail].concat()
    };
    assert_read("stl", [binary(2, 2, &[]), binary(2, 2, b"COLOR=abc"), binary(2, 2, &[0; 50])]);
    assert_refused("stl", [(binary(2, 4, &[]), "promises 2 triangles, 4 follow")]);
}

#[test]
fn decimal_commas_are_named_in_every_text_format() {
    let body = rows(" ", "\n").replace('.', ",");
    let expected = "decimal commas; write decimal points: sed";
    assert_refused("obj", [("v ".to_string() + &body, expected)]);
    assert_refused("off", [(format!("OFF\n6 0\n{body}"), expected)]);
    assert_refused("pcd", [(format!("FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nPOINTS 6\nDATA ascii\n{body}"), expected)]);
    assert_refused(
        "ply",
        [(format!("ply\nformat ascii 1.0\nelement vertex 6\n{PLY_AXES}end_header\n{body}"), expected)],
    );
    assert_refused("stl", [(format!("solid\nfacet vertex {body}endsolid"), "decimal commas")]);
}
