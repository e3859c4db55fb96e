//! Soft-tissue points at recognisable places of the anatomy.

/// Name and planning position (LPS mm) of each landmark.
pub(super) const LANDMARKS: [(&str, [f64; 3]); 18] = [
    ("nose tip", [0.0, -110.0, 19.0]),
    ("epiglottis tip", [0.0, -38.5, -58.5]),
    ("uvula", [0.0, -33.5, -12.0]),
    ("left lens", [32.0, -75.0, 40.0]),
    ("right lens", [-32.0, -75.0, 40.0]),
    ("left carotid bifurcation", [30.0, -23.0, -72.0]),
    ("right carotid bifurcation", [-30.0, -23.0, -72.0]),
    ("left parotid, middle", [59.0, 3.0, -13.0]),
    ("right parotid, middle", [-59.0, 3.0, -13.0]),
    ("left submandibular gland", [35.0, -40.0, -54.0]),
    ("right submandibular gland", [-35.0, -40.0, -54.0]),
    ("thyroid isthmus", [0.0, -47.5, -120.0]),
    ("thyroid cartilage notch", [0.0, -58.0, -77.0]),
    ("tracheal bifurcation", [2.0, 10.0, -228.0]),
    ("left sternocleidomastoid, middle", [46.0, -14.0, -85.0]),
    ("right sternocleidomastoid, middle", [-46.0, -14.0, -85.0]),
    ("left jugular-subclavian confluence", [28.0, -33.0, -163.0]),
    ("spinal cord at C5", [0.0, 9.0, -89.0]),
];
