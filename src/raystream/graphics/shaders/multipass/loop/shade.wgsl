// Shades the hits of pixels' rays, and gives pixels their next rays; see rendering/shade.wgsl.

//! include "multipass/loop/frame.wgsl"
//! include "multipass/loop/pixel_targets.wgsl"
//! include "rendering/shade.wgsl"

fn load_record(texel: vec2i) -> PixelRecord {
    return PixelRecord(
        textureLoad(pixels, texel, 0),
        textureLoad(weights, texel, 0),
        textureLoad(paths, texel, 0),
        textureLoad(lights_found, texel, 0),
    );
}

@fragment
fn shade(@builtin(position) position: vec4f) -> Targets {
    let texel = texel_at(position);
    let state = textureLoad(states, texel, 0);
    if state.x != SHADING && state.x != NO_ROOM {
        return nothing();
    }
    read_pixel(pixel_number(texel), load_record(texel));
    let origin = textureLoad(origins, texel, 0);
    let direction = textureLoad(directions, texel, 0);
    if !has_room() {
        return targets_of(vec4u(NO_ROOM, state.yzw), origin, direction);
    }
    shade_ray(direction.xyz, bitcast<i32>(state.z), textureLoad(founds, texel, 0).xyz);
    let next = next_ray();
    if !next.is_active {
        return targets_of(vec4u(DONE, state.yzw), origin, direction);
    }
    return targets_of(
        vec4u(STARTING, 0u, bitcast<u32>(MISS), params.budget),
        vec4f(next.origin, 0.0),
        search_direction(next),
    );
}
