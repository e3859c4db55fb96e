//! Each format against hand-made files: what moves, what stays, what is refused.

use super::*;

fn read(name: &str, text: &str, space: Option<Space>) -> Result<PointFile> {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join(name);
    std::fs::write(&path, text).unwrap();
    read_points(&path, "planning", space)
}

/// Moves every point by (1, 2, 3) LPS and returns the written file.
fn shifted(name: &str, text: &str, space: Option<Space>) -> (PointFile, Vec<u8>) {
    let file = read(name, text, space).unwrap();
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join(name);
    let moved: Vec<Point3<f64>> = file.points.iter().map(|p| p + nalgebra::Vector3::new(1.0, 2.0, 3.0)).collect();
    file.write(&out, &moved).unwrap();
    (file, std::fs::read(&out).unwrap())
}

fn text(bytes: Vec<u8>) -> String {
    String::from_utf8(bytes).unwrap()
}

#[test]
fn csv_keeps_its_other_columns() {
    let (file, out) = shifted("p.csv", "label,x,y,z,note\ntip,10,20,-30.5,\"a, b\"\n,1,1,1,\n", None);
    assert_eq!(file.names, ["tip", "2"]);
    assert_eq!(file.points[0], Point3::new(10.0, 20.0, -30.5));
    assert_eq!(text(out), "label,x,y,z,note\ntip,11,22,-27.5,\"a, b\"\n,2,3,4,\n");
}

#[test]
fn landmarks_give_the_column_of_their_frame() {
    let head = "name,planning_x,planning_y,planning_z,fraction_x,fraction_y,fraction_z\n";
    let (_, out) = shifted("p.csv", &format!("{head}tip,1,2,3,7,8,9\n"), None);
    assert_eq!(text(out), "name,x,y,z\ntip,2,4,6\n");
}

#[test]
fn markups_keep_their_space_and_everything_else() {
    let list = |space: &str| {
        format!(
            r#"{{"@schema": "s", "markups": [{{"type": "Fiducial", {space} "coordinateUnits": "mm", "controlPoints": [
            {{"id": "1", "label": "F-1", "position": [10.0, 20.0, 30.0], "selected": true}},
            {{"id": "2", "label": "none", "position": [], "positionStatus": "undefined"}}]}}]}}"#
        )
    };
    for (word, read_as, written) in [
        (r#""coordinateSystem": "LPS","#, [10.0, 20.0, 30.0], [11.0, 22.0, 33.0]),
        (r#""coordinateSystem": "RAS","#, [-10.0, -20.0, 30.0], [9.0, 18.0, 33.0]),
        (r#""coordinateSystem": 0,"#, [-10.0, -20.0, 30.0], [9.0, 18.0, 33.0]),
        ("", [10.0, 20.0, 30.0], [11.0, 22.0, 33.0]),
    ] {
        let (file, out) = shifted("m.mrk.json", &list(word), None);
        assert_eq!((file.names.len(), file.points[0]), (1, Point3::from(read_as)), "{word}");
        let json: serde_json::Value = serde_json::from_slice(&out).unwrap();
        let controls = &json["markups"][0]["controlPoints"];
        assert_eq!(controls[0]["position"], serde_json::json!(written), "{word}");
        assert_eq!((&controls[0]["selected"], controls[1]["position"].as_array().unwrap().len()), (&true.into(), 0));
    }
}

#[test]
fn fcsv_says_its_space_or_is_told() {
    let body =
        "# columns = id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID\nn0,10,20,30,0,0,0,1,1,1,0,F-1,,\n";
    for (head, said, expected, line) in [
        ("# CoordinateSystem = 0\n", None, [-10.0, -20.0, 30.0], "n0,9,18,33,0,0,0,1,1,1,0,F-1,,"),
        ("# CoordinateSystem = RAS\n", None, [-10.0, -20.0, 30.0], "n0,9,18,33,0,0,0,1,1,1,0,F-1,,"),
        ("# CoordinateSystem = LPS\n", Some(Space::Lps), [10.0, 20.0, 30.0], "n0,11,22,33,0,0,0,1,1,1,0,F-1,,"),
        ("", Some(Space::Ras), [-10.0, -20.0, 30.0], "n0,9,18,33,0,0,0,1,1,1,0,F-1,,"),
    ] {
        let (file, out) = shifted("p.fcsv", &format!("{head}{body}"), said);
        assert_eq!((file.points[0], file.names[0].as_str()), (Point3::from(expected), "F-1"), "{head}");
        let out = text(out);
        assert_eq!(out.lines().last(), Some(line));
        assert!(out.starts_with(head));
    }
}

#[test]
fn elastix_points() {
    let (file, out) = shifted("p.txt", "point\n2\n10 20 30\n-1.5 0 4e1\n", None);
    assert_eq!(file.points[1], Point3::new(-1.5, 0.0, 40.0));
    assert_eq!(text(out), "point\n2\n11.0000000 22.0000000 33.0000000\n-0.5000000 2.0000000 43.0000000\n");
}

#[test]
fn obj_moves_its_vertices_and_drops_its_normals() {
    let mesh = "# SPACE=RAS\nv 1 2 3\nv 0 0 0 0.5 0.5 0.5\nvn 0 0 1\nvt 0 0\nf 1//1 2/1/1 1\n";
    let (file, out) = shifted("m.obj", mesh, None);
    assert_eq!(file.points[0], Point3::new(-1.0, -2.0, 3.0));
    assert_eq!(text(out), "# SPACE=RAS\nv 0 0 6\nv -1 -2 3 0.5 0.5 0.5\nvt 0 0\nf 1 2/1 1\n");
}

#[test]
fn stl_keeps_its_triangles_and_its_space() {
    let mesh = "solid SPACE=LPS\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 4 0 0\nvertex 0 4 0\nendloop\nendfacet\nendsolid\n";
    let (file, out) = shifted("m.stl", mesh, None);
    assert_eq!(file.points.len(), 3);
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("m.stl");
    std::fs::write(&path, out).unwrap();
    let back = read_points(&path, "planning", None).unwrap();
    assert_eq!(back.points[1], Point3::new(5.0, 2.0, 3.0));
}

#[test]
fn refusals_name_the_file_and_the_value() {
    let plane = r#"{"markups": [{"type": "Plane", "coordinateSystem": "LPS", "controlPoints": []}]}"#;
    let table: [(&str, &str, Option<Space>, &str); 13] = [
        ("a.csv", "name,x,y\na,1,2\n", None, "planning_x"),
        ("b.csv", "name,x,y,z\na,1,2,three\n", None, "line 2: \"three\""),
        ("c.csv", "name,x,y,z\n", None, "no point"),
        ("d.mrk.json", plane, None, "type Plane"),
        ("e.mrk.json", r#"{"markups": [{"coordinateSystem": "SAR", "controlPoints": []}]}"#, None, "SAR"),
        ("f.mrk.json", "{}", None, "no list `markups`"),
        ("g.fcsv", "# columns = id,x,y,z\nn0,1,2,3\n", None, "LPS or RAS"),
        ("h.fcsv", "# CoordinateSystem = 1\nn0,1,2,3\n", Some(Space::Ras), "--space says RAS"),
        ("i.txt", "index\n1\n1 2 3\n", None, "voxel indices"),
        ("j.txt", "point\n2\n1 2 3\n", None, "promises"),
        ("k.obj", "v 1 2 3\n", None, "LPS or RAS"),
        ("l.stl", "no mesh", Some(Space::Lps), "no STL"),
        ("m.csv", "x,y,z\n1,2,3\n", Some(Space::Ras), "LPS, --space says RAS"),
    ];
    for (name, content, space, word) in table {
        let Err(error) = read(name, content, space) else { panic!("{name} was not refused") };
        assert!(error.to_string().contains(word) && error.to_string().contains(name), "{error}");
    }
    let file = read("p.csv", "x,y,z\n1,2,3\n", None).unwrap();
    assert_eq!(file.write("/nowhere/p.fcsv", &file.points).unwrap_err().exit_code(), 2);
}

#[test]
fn units_rows_and_weights_that_would_move_points() {
    let units = |unit: &str| {
        format!(r#"{{"markups":[{{"coordinateUnits":{unit},"controlPoints":[{{"position":[1,2,3]}}]}}]}}"#)
    };
    for unit in [r#""mm""#, r#"["mm"]"#, r#"["mm", "UCUM", "millimeter"]"#, "null"] {
        assert!(read("a.mrk.json", &units(unit), None).is_ok(), "{unit}");
    }
    let refused = |name: &str, text: &str, word: &str| {
        let Err(error) = read(name, text, Some(Space::Lps)) else { panic!("{name} was not refused: {text}") };
        assert!(error.to_string().contains(word) && error.to_string().contains(name), "{word}: {error}");
    };
    for unit in ["[]", "[[]]", "{}", "1", r#""cm""#, r#"["cm", "UCUM", "centimeter"]"#] {
        refused("a.mrk.json", &units(unit), "coordinateUnits");
    }
    for position in ["[1,2]", "[1,2,3,4]", r#"["1",2,3]"#, "{}", "null"] {
        let text = format!(r#"{{"markups":[{{"controlPoints":[{{"position":{position}}}]}}]}}"#);
        refused("a.mrk.json", &text, "not three numbers");
    }
    refused("a.mrk.json", r#"{"markups":[{"coordinateSystem":true,"controlPoints":[]}]}"#, "coordinateSystem");
    for text in ["[]", "1", "null", r#"{"markups":{}}"#, r#"{"markups":[1]}"#] {
        assert!(read("a.mrk.json", text, None).is_err(), "{text}");
    }
    refused("b.csv", "name,x,y,z\na,1,2\n", "line 2 has 3 cells, the first line 4");
    refused("b.csv", "name,x,y,z\na,1,2,3\nb,1,2,3,4\n", "line 3 has 5 cells");
    let fcsv = "# CoordinateSystem = LPS\n# columns = id,x,y,z,label\n";
    refused("c.fcsv", &format!("{fcsv}n,1,2,3\n"), "line 3 has 4 cells, the first line 5");
    assert!(read("c.fcsv", &format!("{fcsv}n,1,2,3,\"a, b\"\n"), None).is_ok());
    refused("d.obj", "v 1 2 3 2\n", "weight 2");
    assert!(read("d.obj", "v 1 2 3 1.0\nv 1 2 3 0 0 1\n", Some(Space::Lps)).is_ok());
    let mut stl = vec![b' '; 80];
    stl.extend(u32::MAX.to_le_bytes());
    stl.extend([0; 50]);
    refused("e.stl", &String::from_utf8_lossy(&stl.iter().map(|b| b & 0x7f).collect::<Vec<u8>>()), "promises");
}

#[test]
fn names_that_spreadsheets_would_run_are_defused_once() {
    let (file, out) = shifted("p.csv", "name,x,y,z\n=1+1,1,1,1\n'-a,2,2,2\n-3,3,3,3\n", None);
    assert_eq!(file.names, ["=1+1", "-a", "-3"]);
    assert_eq!(text(out), "name,x,y,z\n'=1+1,2,3,4\n'-a,3,4,5\n-3,4,5,6\n");
}
