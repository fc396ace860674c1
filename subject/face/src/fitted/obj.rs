//! `face.obj`: Wavefront's format, which every program for shapes reads.

use super::FittedFace;

impl FittedFace {
    /// The wireframe as an OBJ: nominal millimetres, y up, z to the front. Features stand in comments.
    pub fn to_obj(&self) -> String {
        let mut text = String::from("# A face fitted to a photograph by mocapd.\n");
        text += "# Millimetres, nominal; x to the face's left, y up, z to the front.\n";
        for (name, vertex) in &self.features {
            // Control characters would end the comment.
            let name: String = name.chars().filter(|c| !c.is_control()).collect();
            text.push_str(&format!("# feature {name} {}\n", vertex + 1));
        }
        for [x, y, z] in &self.vertices_mm {
            text.push_str(&format!("v {x:.3} {y:.3} {z:.3}\n"));
        }
        for [a, b, c] in &self.triangles {
            text.push_str(&format!("f {} {} {}\n", a + 1, b + 1, c + 1));
        }
        text
    }
}
