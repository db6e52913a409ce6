// Programs after the kernels that give pixels their rays; see multipass/commit.wgsl. They read the
// scratch textures.

//! include "multipass/loop/frame.wgsl"

@fragment
fn commit(@builtin(position) position: vec4f) -> Targets {
    let texel = texel_at(position);
    return Targets(
        textureLoad(states, texel, 0),
        textureLoad(origins, texel, 0),
        textureLoad(directions, texel, 0),
        textureLoad(pixels, texel, 0),
        textureLoad(weights, texel, 0),
        textureLoad(paths, texel, 0),
        textureLoad(lights_found, texel, 0),
    );
}
