//! Rows of text.

use super::*;

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
        "", "NA", "N/A", "NaN", "null", "NULL", "None", "-", "#N/A", "#NV", "#NAME?", "#NUM!", "#DIV/0!", "#VALUE!",
        "\"\"", " ", "<NA>",
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
    assert_eq!([&b"0\n"[..], b""].map(|empty| read("pts", empty)), [Ok(vec![]), Ok(vec![])]);
    let named = lines("N X Y Z").replacen("0 ", "# t a b c\n0 ", 1);
    assert_eq!(read_with("txt", named.as_bytes(), &columns("a,b,c")).unwrap(), POINTS);
    assert_refused("xyz", [(format!("2\n{first}4\n{rest}"), "`format` pts")]);
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
        assert_refused("txt", [(lines(format), "`columns` 2,3,4")]);
        let chosen = read_with("txt", lines(format).replace("# id lon lat h\n", "").as_bytes(), &columns("2,3,4"));
        assert_eq!(chosen.unwrap(), POINTS, "{format}");
    }
    let times =
        "1630450000.103 1 2 3\n1630450000.205 1 2 3\n1630450000.301 1 2 3\n1630450000.4 1 2 3\n1630450000.9 1 2 3\n";
    assert_refused("txt", [(times, "holds times")]);
    assert_refused(
        "csv",
        [
            (lines("PN,X,Y,Z,edge"), "column 1 is `P0`; choose the columns of x, y and z, as in `columns` 2,3,4"),
            (
                format!("6\nhead\n{}", lines("C X Y Z")),
                "`head` above this row does not name its 4 columns; choose those of x, y and z by numbers, as in `columns` 2,3,4",
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
                "the content is PLY: rename the file, or `format` ply",
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
