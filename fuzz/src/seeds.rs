//! Small valid files of every kind, made without the code under test.

fn all(texts: &[&str]) -> Vec<Vec<u8>> {
    texts.iter().map(|t| t.as_bytes().to_vec()).collect()
}

/// A NIfTI-1 header with values behind it.
fn nifti_file(dim: [i16; 8], datatype: i16, bits: i16, intent: i16, extension: &[u8], values: &[u8]) -> Vec<u8> {
    let mut h = vec![0u8; 352];
    let mut put = |at: usize, bytes: &[u8]| h[at..at + bytes.len()].copy_from_slice(bytes);
    put(0, &348i32.to_le_bytes());
    for (n, d) in dim.iter().enumerate() {
        put(40 + 2 * n, &d.to_le_bytes());
    }
    put(68, &intent.to_le_bytes());
    put(70, &datatype.to_le_bytes());
    put(72, &bits.to_le_bytes());
    for (n, spacing) in [1.0f32, 1.5, 2.0, 3.0].iter().enumerate() {
        put(76 + 4 * n, &spacing.to_le_bytes());
    }
    put(108, &(352.0 + extension.len() as f32).to_le_bytes());
    put(112, &1f32.to_le_bytes());
    put(123, &[2]);
    put(148, b"aventail planning_to_fraction: x");
    put(252, &1i16.to_le_bytes());
    put(254, &1i16.to_le_bytes());
    for (row, spacing) in [1.5f32, 2.0, 3.0].iter().enumerate() {
        put(280 + 16 * row + 4 * row, &spacing.to_le_bytes());
        put(280 + 16 * row + 12, &10f32.to_le_bytes());
        put(268 + 4 * row, &10f32.to_le_bytes());
    }
    put(344, b"n+1\0");
    put(348, &[u8::from(!extension.is_empty())]);
    [&h[..], extension, values].concat()
}

pub(super) fn nifti() -> Vec<Vec<u8>> {
    let shorts: Vec<u8> = (0..24i16).flat_map(|v| (v - 7).to_le_bytes()).collect();
    let floats: Vec<u8> = (0..36u8).flat_map(|v| f32::from(v).to_le_bytes()).collect();
    let text = b"<?xml version=\"1.0\"?><CaretExtension><LabelTable><Label Key=\"1\"><![CDATA[bone < ]]>&amp; &#x43;1</Label></LabelTable></CaretExtension>";
    let size = (8 + text.len()).next_multiple_of(16);
    let mut extension = [(size as i32).to_le_bytes(), 0i32.to_le_bytes()].concat();
    extension.extend(text);
    extension.resize(size, b' ');
    vec![
        nifti_file([3, 4, 3, 2, 1, 1, 1, 1], 4, 16, 0, &[], &shorts),
        nifti_file([5, 3, 2, 2, 1, 3, 1, 1], 16, 32, 1007, &[], &floats),
        nifti_file([3, 4, 3, 2, 1, 1, 1, 1], 2, 8, 1002, &extension, &(0..24).map(|v| v % 2).collect::<Vec<u8>>()),
        gzip(&nifti_file([3, 4, 3, 2, 1, 1, 1, 1], 4, 16, 0, &[], &shorts)),
    ]
}

/// A gzip member of stored blocks, so that mutations reach what is in it.
fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut out = vec![0x1f, 0x8b, 8, 0, 0, 0, 0, 0, 0, 255, 1];
    out.extend((bytes.len() as u16).to_le_bytes());
    out.extend((!(bytes.len() as u16)).to_le_bytes());
    out.extend(bytes);
    let crc = bytes.iter().fold(!0u32, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |c, _| if c & 1 == 1 { 0xedb8_8320 ^ (c >> 1) } else { c >> 1 })
    });
    out.extend((!crc).to_le_bytes());
    out.extend((bytes.len() as u32).to_le_bytes());
    out
}

pub(super) fn metaimage() -> Vec<Vec<u8>> {
    let shorts: Vec<u8> = (0..24i16).flat_map(i16::to_le_bytes).collect();
    let floats: Vec<u8> = (0..12u8).flat_map(|v| f32::from(v).to_le_bytes()).collect();
    let head = "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = False\nCompressedData = False\n\
        TransformMatrix = 1 0 0 0 1 0 0 0 1\nOffset = -10 -20 30\nCenterOfRotation = 0 0 0\nAnatomicalOrientation = RAI\nElementSpacing = 2 2 3\n";
    let with = |more: &str, body: &[u8]| [head.as_bytes(), more.as_bytes(), body].concat();
    vec![
        with("DimSize = 4 3 2\nElementType = MET_SHORT\nElementDataFile = LOCAL\n", &shorts),
        with(
            "DimSize = 2 2 1\nElementNumberOfChannels = 3\nElementType = MET_FLOAT\nElementDataFile = LOCAL\n",
            &floats,
        ),
        with(
            "DimSize = 4 3 2\nHeaderSize = -1\nElementNBits = 16\nElementType = MET_SHORT\nElementDataFile = LOCAL\nPAD!",
            &shorts,
        ),
        with("DimSize = 4 3 2\nElementType = MET_SHORT\nElementDataFile = a.raw\n", b""),
    ]
}

const NRRD: &str = "NRRD0004\ntype: uchar\ndimension: 3\nspace: left-posterior-superior\nsizes: 4 3 2\n\
    space directions: (2,0,0) (0,2,0) (0,0,3)\nkinds: domain domain domain\nendian: little\nencoding: raw\nspace origin: (-10,-20,30)\n";

/// A map of the labels 0 to 4.
pub(super) fn label_map() -> Vec<u8> {
    [NRRD.as_bytes(), b"\n", &(0..24).map(|v| v % 5).collect::<Vec<u8>>()].concat()
}

pub(super) fn nrrd() -> Vec<Vec<u8>> {
    let floats: Vec<u8> = (0..12u8).flat_map(|v| f32::from(v).to_le_bytes()).collect();
    let body: Vec<u8> = (0..24).collect();
    let plain = "NRRD0005\ntype: uchar\ndimension: 3\nsizes: 4 3 2\nspacings: 2 3 4\naxis mins: 10 20 30\naxis maxs: 18 29 38\n\
        centers: cell cell cell\nunits: \"mm\" \"mm\" \"mm\"\nencoding: raw\nbyte skip: 2\nline skip: 1\n\nline\nxx";
    let field = "NRRD0004\ntype: float\ndimension: 4\nspace: LPS\nsizes: 3 2 2 1\nspace directions: none (2,0,0) (0,2,0) (0,0,3)\n\
        kinds: vector domain domain domain\nmeasurement frame: (1,0,0) (0,1,0) (0,0,1)\nendian: little\nencoding: raw\n\
        space origin: (1,2,3)\ndisplacement field type:=resampling\n\n";
    let segments = "Segment0_Name:=skull\nSegment0_LabelValue:=1\nSegment1_Name:=a\\nb\nSegment1_LabelValue:=2\n\n";
    let packed = NRRD.replace("raw", "gzip");
    vec![
        label_map(),
        [plain.as_bytes(), &body].concat(),
        [field.as_bytes(), &floats].concat(),
        [NRRD.as_bytes(), segments.as_bytes(), &body].concat(),
        [packed.as_bytes(), b"\n", &gzip(&body)].concat(),
    ]
}

pub(super) fn label_names() -> Vec<Vec<u8>> {
    all(&[
        r#"{"labels": {"1": "skull", "2": "mandible", "3": "hyoid", "4": "hyoid"}}"#,
        r#"{"channel_names": {"0": "CT"}, "labels": {"background": 0, "skull": 1, "a": 2, "b": [3], "c": 4}}"#,
        r#"{"labels": {"head": [1, 2], "skull": 1}, "regions_class_order": [1, 2]}"#,
    ])
}

pub(super) fn points_csv() -> Vec<Vec<u8>> {
    all(&[
        "label,x,y,z,note\ntip,10,20,-30.5,\"a, b\"\n=1+1,1,1,1,\n",
        "name,planning_x,planning_y,planning_z,fraction_x,fraction_y,fraction_z\na,1,2,3,4,5,6\n",
        "\u{feff}z;y;x\n1,2,3\n",
    ])
}

pub(super) fn points_markups() -> Vec<Vec<u8>> {
    all(&[
        r#"{"markups": [{"type": "Fiducial", "coordinateSystem": "RAS", "coordinateUnits": "mm", "controlPoints": [
        {"id": "1", "label": "F-1", "position": [10.0, 20.0, 30.0]}, {"label": "n", "position": [], "positionStatus": "undefined"}]}]}"#,
        r#"{"markups":[{"coordinateUnits":["mm","UCUM","millimeter"],"coordinateSystem":0,"controlPoints":[{"position":[1,2,3]}]}]}"#,
        r#"{"markups":[{"coordinateUnits":[],"controlPoints":[{"position":[1,2,3]}]}]}"#,
    ])
}

pub(super) fn points_fcsv() -> Vec<Vec<u8>> {
    all(&[
        "# Markups fiducial file version = 4.11\n# CoordinateSystem = LPS\n# columns = id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID\n\
        n0,10,20,30,0,0,0,1,1,1,0,F-1,,\n",
        "# CoordinateSystem = 0\nn,1,2,3\n\nm,\"1\",2,3\n",
    ])
}

pub(super) fn points_elastix() -> Vec<Vec<u8>> {
    all(&["point\n2\n10 20 30\n-1.5 0 4e1\n", "index\n1\n1 2 3\n"])
}

pub(super) fn mesh_obj() -> Vec<Vec<u8>> {
    all(&["# SPACE=LPS\nv 1 2 3\nv 0 0 0 0.5 0.5 0.5\nv 1 1 1 1\nvn 0 0 1\nvt 0 0\nf 1//1 2/1/1 3\n"])
}

pub(super) fn mesh_stl() -> Vec<Vec<u8>> {
    let text = "solid SPACE=LPS\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 4 0 0\nvertex 0 4 0\nendloop\nendfacet\nendsolid\n";
    let mut binary = b"SPACE=RAS".to_vec();
    binary.resize(80, b' ');
    binary.extend(1u32.to_le_bytes());
    binary.extend([0f32, 0.0, 1.0, 0.0, 0.0, 0.0, 4.0, 0.0, 0.0, 0.0, 4.0, 0.0].iter().flat_map(|v| v.to_le_bytes()));
    binary.extend([0, 0]);
    vec![text.as_bytes().to_vec(), binary]
}

pub(super) fn contours() -> Vec<Vec<u8>> {
    all(&[
        r#"{"aventail_contours": 1, "frame": "planning", "orientation": [1,0,0,0,1,0], "structures": [{"name": "cord",
        "colour": [250, 220, 60], "contours": [[[4.0, 9.5, -89.0], [3.2, 12.1, -89.0], [-1.0, 10.7, -89.0]]]}]}"#,
    ])
}

pub(super) fn landmarks() -> Vec<Vec<u8>> {
    all(&[
        "bone,name,planning_x,planning_y,planning_z,fraction_x,fraction_y,fraction_z\nskull,nasion,1,2,3,4,5,6\n\n,,,,,,,\n",
        "name,planning_x,planning_y,planning_z,fraction_x,fraction_y,fraction_z\n\"C2, tip \"\"dens\"\"\",1,2,-3.5e0,4,5,6\n",
    ])
}

pub(super) fn density() -> Vec<Vec<u8>> {
    all(&["HU,density\n-1000, 0.001\n0,1\n3000,2.8\n", "-1000,0.0012\n100,1.1\n"])
}

pub(super) fn transform_text() -> Vec<Vec<u8>> {
    let itk = |kind: &str, parameters: &str, fixed: &str| {
        format!(
            "#Insight Transform File V1.0\n#Transform 0\nTransform: {kind}_double_3_3\nParameters: {parameters}\nFixedParameters: {fixed}\n"
        )
        .into_bytes()
    };
    vec![
        b"0 -1 0 5\n1 0 0 6\n0 0 1 7\n0 0 0 1\n".to_vec(),
        itk("Euler3DTransform", "0.1 -0.2 0.3 1 2 3", "5 6 7 0"),
        itk("VersorRigid3DTransform", "0.1 0.2 -0.15 1 2 3", "5 6 7"),
        itk("AffineTransform", "1 0 0 0 1 0 0 0 1 0 0 0", "0 0 0"),
    ]
}

pub(super) fn transform_json() -> Vec<Vec<u8>> {
    all(&[
        r#"{"skull": [[1,0,0,1],[0,1,0,0],[0,0,1,0],[0,0,0,1]], "hyoid": [[1,0,0,2],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}"#,
        "[[0,-1,0,8],[1,0,0,-12],[0,0,1,4],[0,0,0,1]]",
    ])
}

pub(super) fn settings() -> Vec<Vec<u8>> {
    all(&[
        "[fit]\nmax_iterations = 10\n[chainmail]\nmaterial = [{ hu = 0, min = 0.8, max = 1.2, shear = 0.1 }]\n[output]\nregions = true\n",
        "\u{feff}[chainmail]\nspacing_mm = [3, 3, 3]\nmaterial = \"stiff\"\n",
    ])
}

pub(super) fn study() -> Vec<Vec<u8>> {
    vec![include_bytes!("../../data/study.toml").to_vec()]
}

pub(super) fn pose() -> Vec<Vec<u8>> {
    all(&[
        "[couch]\nshift_mm = [1, 2, 3]\nrotation_deg = [0, 1, 0]\n[bones.skull]\nflexion_deg = 10\nshift_mm = [0, 0, 1.5]\n",
        "skull = { rotation_deg = [1, 0, 0] }\n",
        "[bones.skull]\nrotation_deg = [1, 0, 0]\n",
    ])
}

pub(super) fn cbct() -> Vec<Vec<u8>> {
    all(&[
        "gain = 0.8\ncupping_hu = -180.0\nnoise_hu = 60.0\ncircle_radius_mm = 50\ncircle_offset_mm = [5, -3.5]\n",
        "blank_slices = [1, 2]\nlength_mm = 1e300\nstreak_hu = 80.0\nshading_mm = 150.0\npadding_hu = -2000\n",
    ])
}

pub(super) fn skeleton() -> Vec<Vec<u8>> {
    all(&[
        "[bones.skull]\nparent = \"vertebrae_C7\"\njoint = \"j\"\ncentre_mm = [1, 2, 3]\naxes = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\n",
    ])
}

pub(super) fn report() -> Vec<Vec<u8>> {
    all(&[
        r#"{"version": "0.1.0", "command": "aventail", "settings": {"fit": {"max_iterations": 10}}, "inputs": [{"role": "planning", "path": "a.nii", "sha256": "00"}], "warnings": []}"#,
    ])
}
