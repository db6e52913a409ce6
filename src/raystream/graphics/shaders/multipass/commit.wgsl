// What comes after a kernel: its records are copied from scratch textures to the streams, and its
// rays are told what they wait for next. Here the textures that are read are the scratch ones.

// Of the pipeline: see classify().
override NEXT: u32 = 0u;

// All rays begin; texels that are no ray's never do, nor do rays that want no hits.
@fragment
fn begin(@builtin(position) position: vec4f) -> Texels {
    let texel = texel_at(position);
    let wish = textureLoad(wanted, texel, 0);
    if ray_number(texel) >= params.ray_count || (QUERY == MULTI_HIT && wish.y == 0u) {
        discard;
    }
    return texels_of(
        vec4u(STARTING, 0u, bitcast<u32>(MISS), params.budget),
        vec4f(FAR, 0.0, 0.0, FAR),
        vec4u(),
        vec4f(),
    );
}

@fragment
fn commit(@builtin(position) position: vec4f) -> Texels {
    let texel = texel_at(position);
    return texels_of(
        textureLoad(states, texel, 0),
        textureLoad(founds, texel, 0),
        textureLoad(places, texel, 0),
        textureLoad(spans, texel, 0),
    );
}

// Keep the fragments whose rays go on to one state: the stencil operation then takes them there.
@fragment
fn classify(@builtin(position) position: vec4f) {
    if textureLoad(states, texel_at(position), 0).x != NEXT {
        discard;
    }
}
