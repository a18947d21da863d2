//! Files as other programs write them: what is read, what is refused, and which advice a refusal gives.

use snake_core::Point;
use snake_io::{PointFormat, ReadOptions, parse_cloud};

const POINTS: [Point; 6] = [
    [1.087, -0.054, 0.312],
    [-0.5, 2.25, 7.0],
    [3.125, 0.001, -4.5],
    [0.0, 12.5, 1.75],
    [8.5, -6.0, 0.054],
    [-2.0, 0.25, 9.5],
];

/// The points in rows of text.
fn rows(separator: &str, end: &str) -> String {
    POINTS.iter().map(|point| point.map(|v| format!("{v:.3}")).join(separator) + end).collect()
}

/// Rows of `FORMAT`, in which X, Y and Z stand for the coordinates and N for the number of the row from 0.
fn lines(format: &str) -> String {
    let line = |(number, [x, y, z]): (usize, Point)| {
        let numbers = [("X", x), ("Y", y), ("Z", z)];
        let line = format.replace('N', &number.to_string());
        numbers.iter().fold(line, |line, (axis, v)| line.replace(axis, &format!("{v:.3}"))) + "\n"
    };
    (0..).zip(POINTS).map(line).collect()
}

fn read_with(format: &str, bytes: &[u8], options: &ReadOptions) -> Result<Vec<Point>, String> {
    let format = PointFormat::from_extension(format).unwrap();
    parse_cloud(bytes, format, options).map(|cloud| cloud.into_points()).map_err(|error| error.to_string())
}

fn read(format: &str, bytes: &[u8]) -> Result<Vec<Point>, String> {
    read_with(format, bytes, &ReadOptions::default())
}

fn columns(columns: &str) -> ReadOptions {
    ReadOptions::default().with_columns(Some(columns.parse().unwrap()))
}

/// Checks that all these contents hold [`POINTS`].
#[track_caller]
fn assert_read<B: AsRef<[u8]>>(format: &str, contents: impl IntoIterator<Item = B>) {
    for content in contents {
        let shown = String::from_utf8_lossy(&content.as_ref()[..content.as_ref().len().min(200)]).into_owned();
        let points = read(format, content.as_ref()).unwrap_or_else(|reason| panic!("{reason}\n{shown}"));
        assert_eq!(points, POINTS, "{shown}");
    }
}

/// Checks that these contents are refused with these words.
#[track_caller]
fn assert_refused<B: AsRef<[u8]>>(format: &str, contents: impl IntoIterator<Item = (B, &'static str)>) {
    for (content, expected) in contents {
        let shown = String::from_utf8_lossy(&content.as_ref()[..content.as_ref().len().min(200)]).into_owned();
        let reason = read(format, content.as_ref()).map(|points| points.len()).expect_err(&shown);
        assert!(reason.contains(expected), "{reason}\n{shown}");
    }
}

#[test]
fn text_with_the_line_ends_and_encodings_of_every_system() {
    for end in ["\n", "\r\n", "\r", "\n\r", "\r\n\r\n"] {
        let body = rows(" ", end);
        assert_read("xyz", [body.clone(), format!("\u{feff}{body}"), format!("\u{feff}x y z{end}{body}")]);
        assert_read("pts", [format!("\u{feff}6{end}{body}")]);
    }
    let mixed = rows(" ", "\n").replacen('\n', "\r", 2).replacen('\n', "\r\n", 1);
    assert_read("xyz", [mixed, rows(" ", "\n") + "\x1a", rows(" ", "\n") + "\0\0\0\0", rows(" ", "\n") + "\r\n\x1a\0"]);
    assert_read("txt", [rows("\u{a0}", "\n"), rows("\u{3000}", "\n"), rows(" ", "\n").replace('-', "\u{2212}")]);
    let remarks = lines("X;Y;Z;Stra?e").replace('?', "\u{df}");
    let latin: Vec<u8> = remarks.chars().map(|c| c as u8).collect();
    assert_read("csv", [remarks.into_bytes(), latin]);
    for utf_16 in
        [b"\xff\xfe1\0 \x002\0 \x003\0".to_vec(), "\u{feff}1 2 3".encode_utf16().flat_map(u16::to_be_bytes).collect()]
    {
        assert_refused("csv", [(utf_16, "iconv -f UTF-16 -t UTF-8")]);
    }
}

#[test]
fn text_with_every_separator_and_comment() {
    assert_read(
        "txt",
        [
            rows("|", "\n"),
            lines("| X | Y | Z |"),
            lines("[X Y Z]"),
            format!("[{}]", lines("[X, Y, Z],")),
            lines("(X, Y, Z)"),
            lines("\"X\",\"Y\",\"Z\""),
            format!("% x y z\n{}", rows(" ", "\n")),
            format!("! made by\n{}", rows(" ", "\n")),
            format!("% made by\n// for\n# us\n{}", rows(", ", "\n")),
            rows(",", ",\n"),
            format!("x,y,z\n{}", rows(",", ",\n")),
            format!("x\ty\tz\n{}", rows("\t", "\t\t\n")),
            format!("x,y,z\n{}", lines("X,Y,Z,edge of roof")),
            lines("X Y Z edge of roof") + "\n",
        ],
    );
}

#[test]
fn numbers_as_fortran_and_windows_print_them() {
    assert_read(
        "xyz",
        [
            lines("+X Y Z").replace("+-", "-"),
            rows(" ", "\n").replace("0.001", "1.0D-03"),
            rows(" ", "\n").replace("-0.500", "-5d-1"),
        ],
    );
    for word in
        ["nan", "-nan", "-nan(ind)", "nan(snan)", "-1.#IND", "1.#QNAN", "-1.#IND00", "1.#INF", "-inf", "+Infinity"]
    {
        let body = format!("1 2 3\n{word} {word} {word}\n4 5 6\n");
        let ply = format!("ply\nformat ascii 1.0\nelement vertex 3\n{PLY_AXES}end_header\n{body}");
        let pcd = format!("FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nPOINTS 3\nDATA ascii\n{body}");
        for (format, text) in [
            ("xyz", body.clone()),
            ("ply", ply),
            ("pcd", pcd),
            ("obj", body.replace('\n', "\nv ").replacen("1 2", "v 1 2", 1)),
        ] {
            let points = read(format, text.as_bytes()).unwrap_or_else(|reason| panic!("{format} {word}: {reason}"));
            assert_eq!((points[0], points[2]), ([1.0, 2.0, 3.0], [4.0, 5.0, 6.0]), "{format} {word}");
            assert!(points[1].iter().all(|v| !v.is_finite()), "{format} {word}");
        }
        // Normals are not used.
        let normals = rows(" ", &format!(" {word} {word} {word}\n"));
        let properties = format!("{PLY_AXES}property float nx\nproperty float ny\nproperty float nz\n");
        assert_read("ply", [format!("ply\nformat ascii 1.0\nelement vertex 6\n{properties}end_header\n{normals}")]);
        assert_read("xyz", [normals]);
    }
}

#[test]
fn cells_without_a_value_are_not_finite() {
    for word in [
        "", "NA", "N/A", "NaN", "null", "NULL", "None", "-", "#N/A", "#NUM!", "#DIV/0!", "#VALUE!", "\"\"", " ", "<NA>",
    ] {
        for separator in [",", ";", "\t"] {
            let text = format!("x,y,z,i\n1,2,3,4\n{word},{word},{word},4\n5,6,,4\n7,8,9,4\n").replace(',', separator);
            let points =
                read("csv", text.as_bytes()).unwrap_or_else(|reason| panic!("{word:?} {separator:?}: {reason}"));
            assert_eq!((points.len(), points[0], points[3]), (4, [1.0, 2.0, 3.0], [7.0, 8.0, 9.0]), "{word:?}");
            assert!(points[1].iter().all(|v| v.is_nan()) && points[2][2].is_nan(), "{word:?} {separator:?}");
        }
    }
}

#[test]
fn lines_above_the_points() {
    let colmap = "# 3D point list with one line of data per point:\n#   POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n# Number of points: 6\n";
    assert_read(
        "txt",
        [
            format!("{colmap}{}", lines("N X Y Z 9 9 9 0.5 1 7 2 9").replacen("2 9\n", "2 9 3 4\n", 2)),
            format!("6\n{}", rows(" ", "\n")),
            format!("X,Y,Z\nm,m,m\n{}", rows(",", "\n")),
            format!("X,Y,Z,t\n(mm),(mm),(mm),s\n{}", lines("X,Y,Z,1")),
            format!("Survey of 3 May\nX,Y,Z\n{}", rows(",", "\n")),
            format!("Survey of May\n\nStation 7\nX;Y;Z\n{}", rows(";", "\n")),
            format!("sep=,\n{}", rows(",", "\n")),
            format!("sep=;\r\nx;y;z\r\n{}", rows(";", "\r\n")),
            format!("# columns: x y z\n{}", rows(" ", "\n")),
            format!("# time x y z\n{}", lines("N X Y Z")),
            format!("# the x y z of points\n{}", rows(" ", "\n")),
            format!("\"X [m]\";\"Y [m]\";\"Z [m]\"\n{}", rows(";", "\n")),
            format!("x|y|z\n{}", rows("|", "\n")),
        ],
    );
    let first = rows(" ", "\n").lines().take(2).fold(String::new(), |all, line| all + line + "\n");
    let rest = rows(" ", "\n").replacen(&first, "", 1);
    assert_read(
        "pts",
        [format!("2\n{first}4\n{rest}"), rows(" ", " -1204 255 0 0\n"), format!("  6  \n{}", rows(" ", "\n"))],
    );
    assert_eq!(read("csv", b"x,y,z\n"), Ok(vec![]));
    assert_refused("xyz", [(format!("2\n{first}4\n{rest}"), "--input-format pts")]);
    assert_refused(
        "pts",
        [(
            format!("5\n{}", rows(" ", "\n")),
            "line 1 promises 5 points, 6 follow; to read them all, remove this line: sed 1d",
        )],
    );
}

#[test]
fn decimal_commas_are_refused() {
    let commas = |text: String| text.replace('.', ",");
    let points = "sed 's/,/./g' FILE > NEW";
    let twice = "commas between the columns";
    for header in ["", "x?y?z\n"] {
        for separator in [";", "\t", " ", "; ", ";\t"] {
            let text = header.replace('?', separator) + &commas(rows(separator, "\n"));
            assert_refused("csv", [(text, points)]);
        }
    }
    assert_refused(
        "csv",
        [
            (commas(rows(",", "\n")), "decimal commas"),
            (commas(rows(", ", "\n")), "decimal commas"),
            (commas(lines("X,Y,Z") + "1.5,2.5,3.5\n"), "decimal commas"),
            ("1,5,2,5,3,5\n2,5,3,5,4,5\n".into(), "decimal commas"),
            ("1,5,2,3,5\n2,5,3,5,4,5\n".into(), "decimal commas"),
            ("1,2,3\n2,5,3,5,4,5\n".into(), "decimal commas"),
            (format!("x,y,z\n{}", commas(rows(",", "\n"))), "6 columns below 3 names"),
            (format!("x, y, z\n{}", commas(rows(", ", "\n"))), "6 columns below 3 names"),
            (format!("x,y,z,i\n{}", commas(lines("X,Y,Z,9"))), "7 columns below 4 names"),
            (format!("//X,Y,Z\n{}", commas(rows(",", "\n"))), "decimal commas"),
            (
                "x,y,z\n1,2,3\n1,2,3,5\n".into(),
                "line 3: 4 columns below 3 names in `1,2,3,5`; are these decimal commas",
            ),
            (commas(lines("\"X\",\"Y\",\"Z\"")), twice),
            ("1,087 -0.054 -0.312\n".into(), "decimal commas"),
            ("1,234.5 2,345.6 3,456.7\n".into(), "thousands"),
            ("\"1,087.0\",\"-54.0\",\"2,312.0\"\n".into(), "thousands"),
            ("1'234.5;2'345.6;3'456.7\n".into(), "thousands"),
        ],
    );
    // Integers in columns of their own, and what is chosen by numbers.
    assert_eq!(read("csv", b"1500,2300,3100,255,128,64\n1501,20,3100,25,128,64\n").unwrap()[1], [1501.0, 20.0, 3100.0]);
    assert_eq!(read("csv", b"0001,1500,2300,3100,1,1\n0002,1500,2300,3101,12,2\n").unwrap()[1][1], 1500.0);
    assert_eq!(read_with("csv", b"1,5,2,5,3,5\n", &columns("1,3,5")), Ok(vec![[1.0, 2.0, 3.0]]));
}

#[test]
fn an_index_or_time_before_the_coordinates_is_refused() {
    for format in
        ["N X Y Z", "N,X,Y,Z,255", "100N X Y Z", "163045000N.5 X Y Z 0 0 0 1", "0.N;X;Y;Z", "# id lon lat h\nN X Y Z"]
    {
        assert_refused("txt", [(lines(format), "--columns 2,3,4")]);
        let chosen = read_with("txt", lines(format).replace("# id lon lat h\n", "").as_bytes(), &columns("2,3,4"));
        assert_eq!(chosen.unwrap(), POINTS, "{format}");
    }
    let times =
        "1630450000.103 1 2 3\n1630450000.205 1 2 3\n1630450000.301 1 2 3\n1630450000.4 1 2 3\n1630450000.9 1 2 3\n";
    assert_refused("txt", [(times, "holds times")]);
    assert_refused(
        "csv",
        [
            (lines("PN,X,Y,Z,edge"), "column 1 is `P0`; choose the columns of x, y and z, as in --columns 2,3,4"),
            (
                format!("6\nhead\n{}", lines("C X Y Z")),
                "`head` above this row does not name its 4 columns; choose those of x, y and z by numbers, as in --columns 2,3,4",
            ),
            (format!("# r g b x y z\n{}", lines("9 9 9 X Y Z 5")), "a comment names 6 columns, the first row has 7"),
            (format!("x y z\n{}", lines("N X Y Z")), "4 columns below 3 names"),
            ("x y z i\n1 2 3 4\n1 2 3\n".into(), "3 columns below 4 names"),
            ("1 2 3 4\n1 2 3\n".into(), "3 numbers, 4 in the first row"),
            ("1 1 0 0 0 1 2 3 1 a.jpg\n1 2 3 4 5 6\n".into(), "6 numbers, 9 in the first row"),
        ],
    );
    // A profile along x, sorted scans and small clouds are no indices.
    for text in [
        "0 1 2\n1 1 2\n2 1 2\n3 1 2\n4 1 2\n5 1 2\n",
        "0 1 2 9\n1 1 2 9\n2 1 2 9\n",
        "0 0 0 1\n0 1 2 9\n.5 1 2 9\n.7 1 2 9\n2 1 2 9\n2.1 0 0 1\n",
    ] {
        read("xyz", text.as_bytes()).unwrap();
    }
}

#[test]
fn other_contents_are_named() {
    assert_refused(
        "csv",
        [
            ("ncols 5\nnrows 4\nxllcorner 3\n1 2 3 4 5\n".into(), "gdal_translate -of XYZ"),
            (
                format!("x,y,z\n{}x,y,z\n1,2,3\n", rows(",", "\n")),
                "line 8: no three coordinates in `x,y,z`: the header once more",
            ),
            ("Latitude,Longitude,Altitude\n1,2,3\n".into(), "project them to metres"),
            ("1 0 0 0.5\n0 1 0 2\n0 0 1 3\n0 0 0 1\n".into(), "4 x 4 matrix"),
            (
                format!("ply\nformat ascii 1.0\nelement vertex 6\n{PLY_AXES}end_header\n"),
                "the content is PLY: rename the file, or --input-format ply",
            ),
            ("1 2\n".into(), "2 columns where 3 are needed"),
        ],
    );
    assert_refused("xyz", [(&b"\x1f\x8b\x08\0\0\0"[..], "gunzip FILE"), (b"PK\x03\x04abc", "the content is NPZ")]);
    assert_refused(
        "xyz",
        [("x,y\n1,2\n", "no three coordinates in `1,2` below"), ("[[1, 2, 3], [4, 5, 6]]", "no three coordinates")],
    );
    assert_eq!(read_with("txt", b"1 0 0 0.5\n0 1 0 2\n0 0 1 3\n0 0 0 1\n", &columns("1,2,3")).unwrap().len(), 4);
}

const PLY_AXES: &str = "property float x\nproperty float y\nproperty float z\n";

fn floats(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

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

/// An array with this description and shape.
fn npy(descr: &str, shape: &str, data: &[u8]) -> Vec<u8> {
    let descr = if descr.starts_with('[') { descr.into() } else { format!("'{descr}'") };
    let header = format!("{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}\n");
    [b"\x93NUMPY\x01\0", &(header.len() as u16).to_le_bytes()[..], header.as_bytes(), data].concat()
}

#[test]
fn arrays_of_other_shapes_and_types() {
    assert_eq!(
        read("npy", &npy("<f2", "(1, 3)", &[0, 0x3c, 0, 0xc0, 0x55, 0x35])).unwrap(),
        [[1.0, -2.0, 0.333_251_95]]
    );
    let zeros = |number: usize| vec![0; 8 * number];
    assert_refused(
        "npy",
        [
            (npy("<f8", "(3, 300)", &zeros(900)), "numpy.save(\"cloud.npy\", a.T)"),
            (npy("<f8", "(4, 300)", &zeros(1200)), "4 points of 300 values; if it is 300 points"),
            (npy("<f8", "(4, 4)", &[zeros(15), 1.0_f64.to_le_bytes().to_vec()].concat()), "4 x 4 matrix"),
            (npy("<f8", "(2, 3, 3)", &zeros(18)), "a.reshape(-1, 3)"),
            (npy("[('x', '<f4'), ('y', '<f4'), ('z', '<f4')]", "(2,)", &zeros(3)), "a structured array"),
            (npy("|O", "(2, 3)", &zeros(6)), "a.astype(float)"),
            (npy("<f8", "(2, 3)", &[zeros(6), vec![1; 99]].concat()), "99 bytes are left over"),
        ],
    );
    assert_eq!(read_with("npy", &npy("<f8", "(3, 300)", &zeros(900)), &columns("1,2,3")).unwrap().len(), 3);
    assert_eq!(read("npy", &npy("<f8", "(3, 6)", &zeros(18))).unwrap().len(), 3);
}

/// A sweep over ground and a wall, with `values` float32 values a point: intensity, elongation and zeros.
fn sweep(values: usize) -> Vec<u8> {
    let random = |seed: usize| ((seed as f64 * 12.9898).sin() * 43758.5453).fract().abs() as f32;
    let point = |index: usize| {
        let (azimuth, elevation) = ((index / 16) as f32 * 0.0419, ((index % 16) as f32 * 1.33 - 15.0).to_radians());
        let ground = if elevation < 0.0 { 1.8 / (-elevation).tan() } else { 75.0 };
        let range = ground.min(12.0 / azimuth.sin().abs().max(0.05)).min(75.0) + random(index) * 0.02;
        let [x, y, z] = [range * azimuth.cos(), range * azimuth.sin(), range * elevation.tan()];
        [x, y, z, random(7 * index), 0.3 * random(3 * index), 0.1, 0.0, 0.0][..values].to_vec()
    };
    floats(&(0..2400).flat_map(point).collect::<Vec<f32>>())
}

#[test]
fn sweeps_with_other_numbers_of_values() {
    for (format, values) in
        [("kitti", 4), ("nuscenes", 5), ("kitti:3", 3), ("kitti:5", 5), ("kitti:6", 6), ("kitti:8", 8)]
    {
        let bytes = sweep(values);
        let points = read(format, &bytes).unwrap();
        assert_eq!(
            (points.len(), points[5][0]),
            (2400, f32::from_le_bytes(bytes[20 * values..][..4].try_into().unwrap()))
        );
    }
    for values in [3, 5, 6, 8] {
        let expected: &str = match values {
            3 => "--input-format kitti:3",
            5 => "--input-format kitti:5",
            6 => "--input-format kitti:6",
            _ => "--input-format kitti:8",
        };
        assert_refused("kitti", [(sweep(values), expected)]);
        assert_eq!(read("kitti:4", &sweep(values)).unwrap().len(), 600 * values);
    }
    assert_refused("nuscenes", [(sweep(4), "--input-format kitti:4")]);
    assert_refused("kitti:4", [(sweep(5)[..20 * 2399].to_vec(), "what fits is --input-format kitti:5")]);
    let doubles: Vec<u8> = POINTS
        .as_flattened()
        .iter()
        .cycle()
        .take(4000)
        .flat_map(|v| (f64::from(*v) * 1.1 + 0.01).to_le_bytes())
        .collect();
    assert_refused("kitti", [(doubles, "no float32 coordinates")]);
    // Every second return is missing.
    let gaps: Vec<u8> = sweep(4).chunks(16).flat_map(|point| [point, &[0; 16]].concat()).collect();
    assert_eq!(read("kitti", &gaps).unwrap().len(), 4800);
    for extension in ["kitti:2", "kitti:", "kitti:x", "kitti:65", "kitti:-1"] {
        assert!(PointFormat::from_extension(extension).is_none(), "{extension}");
    }
}
