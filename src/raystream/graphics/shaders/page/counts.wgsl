// Counts of work in place of light: steps, leaves and tests of the search for a pixel's first hit.

//! include "rendering/shade.wgsl"

fn shade_hit(_t: f32) -> bool {
    let steps = tally.steps + tally.backtrack_steps;
    gathered = vec3f(f32(steps), f32(tally.leaves), f32(tally.tests));
    return false;
}

fn shadow_of(path: Path, k: u32) -> Spawned {
    return NO_RAY;
}

fn onward_of(path: Path, branch: u32) -> Spawned {
    return NO_RAY;
}
