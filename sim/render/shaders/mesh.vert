#version 330 core
// One instance of the object, projected by the camera model itself and put into its tile of the atlas.
// Attribute locations are those of pyrender's meshes.

layout(location = 0) in vec3 position;     // [m], frame of the part
layout(location = 1) in vec3 normal;
layout(location = 2) in vec4 color_0;      // r = albedo
layout(location = 3) in mat4 inst_m;       // part -> camera; its last row holds the tile's shift

uniform vec4 intrinsics;                   // fu, fv, pu, pv [px]
uniform vec4 distortion;                   // k1, k2, p1, p2 or k1..k4
uniform int distortion_model;              // 0 none, 1 radtan, 2 equidistant
uniform mat2 lattice;                      // pixels -> lattice samples
uniform vec2 pixel_centre;                 // of a pixel's samples [samples]
uniform vec2 viewport;                     // [samples]
uniform vec2 tile_size;                    // [samples]
uniform vec2 depth_range;                  // near, far [m]
uniform vec3 light;                        // unit vector towards the light, camera frame
uniform float ambient;                     // share of the light that comes from everywhere

flat out uint word;
out gl_PerVertex {
    vec4 gl_Position;
    float gl_ClipDistance[4];
};

vec2 distort(vec2 p)
{
    float r2 = dot(p, p);
    if (distortion_model == 1) {
        float radial = 1.0 + r2 * (distortion.x + r2 * distortion.y);
        vec2 t = distortion.zw;
        return p * radial + 2.0 * p.x * p.y * t + t.yx * (r2 + 2.0 * p * p);
    }
    if (distortion_model == 2) {
        float r = sqrt(r2);
        float theta = atan(r);
        float s = theta * theta;
        float bent = 1.0 + s * (distortion.x + s * (distortion.y + s * (distortion.z + s * distortion.w)));
        return r > 1e-8 ? p * (theta * bent / r) : p;
    }
    return p;
}

void main()
{
    mat4 T_C_P = mat4(vec4(inst_m[0].xyz, 0), vec4(inst_m[1].xyz, 0),
                      vec4(inst_m[2].xyz, 0), vec4(inst_m[3].xyz, 1));
    vec2 tile_shift = vec2(inst_m[0].w, inst_m[1].w);
    vec2 tile_corner = vec2(inst_m[2].w, inst_m[3].w);
    vec3 p = vec3(T_C_P * vec4(position, 1.0));

    vec2 pixel = intrinsics.xy * distort(p.xy / p.z) + intrinsics.zw;
    // Samples lie at integer lattice coordinates, the rasteriser's at half-integers. Rounding to the
    // rasteriser's own 1/256 here makes the picture the same wherever the tile lies in the atlas.
    vec2 at = lattice * pixel + pixel_centre + 0.5;
    at = floor(at * 256.0 + 0.5) / 256.0 + tile_shift;

    float near = depth_range.x, far = depth_range.y;
    float depth = (far + near - 2.0 * far * near / p.z) / (far - near);
    gl_Position = vec4(at * (2.0 / viewport) - 1.0, depth, 1.0);

    vec2 inside = at - tile_corner;
    gl_ClipDistance[0] = inside.x;
    gl_ClipDistance[1] = inside.y;
    gl_ClipDistance[2] = tile_size.x - inside.x;
    gl_ClipDistance[3] = tile_size.y - inside.y;

    vec3 n = normalize(mat3(T_C_P) * normal);
    float shade = ambient + (1.0 - ambient) * max(dot(n, light), 0.0);
    uint code = uint(clamp(color_0.r * shade, 0.0, 1.0) * 65535.0 + 0.5);
    word = (1u << 26) | code;              // one object sample of this luminance
}
