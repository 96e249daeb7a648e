'use strict';
// Every voxel, or cell of a coarser tile, is one point whose fragments are traced against its cube:
// ten million cubes cost what as many points cost.
const VERTEX = `
  precision highp float; precision highp int; precision highp sampler2D;
  in vec3 position; in vec4 _measures; in float _label, _last_seen;
  uniform mat4 modelViewMatrix, projectionMatrix;
  uniform mat3 turn; uniform float pixels, everywhere, seconds, most; uniform int mode;
  uniform sampler2D palette, ramp, sources;
  flat out vec3 color, toward, open; flat out float sprite, lit, edge;
  void main() {
    int label = int(_label), sides = int(_measures.w);
    bool gone = (sides & 64) != 0;
    vec4 own = texelFetch(palette, ivec2(label & 255, label >> 8), 0);
    float value = mode == 1 ? _measures.x / 255.0 : mode == 2 ? _measures.y / most
      : clamp(_last_seen / seconds, 0.0, 1.0);
    color = mode == 0 ? own.rgb
      : mode == 3 ? texelFetch(sources, ivec2(int(_measures.z), 0), 0).rgb
      : mode == 5 ? (gone ? vec3(1.0, 0.35, 0.1) : mix(own.rgb, vec3(0.5), 0.85))
      : texelFetch(ramp, ivec2(int(255.0 * min(value, 1.0)), 0), 0).rgb;
    vec4 seen = modelViewMatrix * vec4(position, 1.0);
    edge = length(modelViewMatrix[0].xyz);
    toward = -(turn * seen.xyz) / edge;         // from the cube's centre to the eye, in edges
    ivec3 bit = ivec3(0, 2, 4) + ivec3(greaterThan(toward, vec3(0.0)));
    open = vec3((ivec3(sides) >> bit) & 1);
    if (open == vec3(0.0)) open = vec3(everywhere);
    vec3 area = open * abs(toward);
    lit = dot(area, vec3(0.8, 0.68, toward.z < 0.0 ? 0.55 : 1.0)) /
          max(area.x + area.y + area.z, 1e-6);
    open = max(open, vec3(everywhere));
    gl_Position = projectionMatrix * seen;
    sprite = clamp(2.1 * pixels * edge / max(-seen.z, 0.001), 1.5, 500.0);
    gl_PointSize = sprite;
    if (own.a == 0.0 || lit == 0.0 || gone && mode != 5) gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
  }`;
const FRAGMENT = `
  precision highp float; precision highp int;
  flat in vec3 color, toward, open; flat in float sprite, lit, edge;
  uniform mat3 turn; uniform float pixels, reach, asking;
  out vec4 result;
  void main() {
    float light = lit, away = length(toward) - 0.5;
    if (sprite > 6.0) {
      // In the plane of the cube's centre, across the line of sight of the camera.
      float far = dot(turn[2], toward);
      vec2 offset = (gl_PointCoord - 0.5) * vec2(1.0, -1.0) * sprite * far / pixels;
      vec3 ray = normalize(turn[0] * offset.x + turn[1] * offset.y - toward);
      vec3 a = (-0.5 - toward) / ray, b = (0.5 - toward) / ray;
      vec3 first = min(a, b), last = max(a, b);
      away = max(max(first.x, first.y), first.z);
      if (away > min(min(last.x, last.y), last.z)) discard;
      vec3 face = vec3(equal(first, vec3(away)));
      light = dot(face * open, vec3(0.8, 0.68, ray.z > 0.0 ? 0.55 : 1.0));
      if (light == 0.0) discard;        // another voxel's face lies before this one
    } else if (sprite > 3.0 && any(greaterThan(abs(gl_PointCoord - 0.5), vec2(0.36)))) discard;
    result = vec4(color * light, 1.0);
    if (asking > 0.0) {                 // asked what is here: how far away, in three bytes
      int far = int(clamp(away * edge / reach, 0.0, 1.0) * 16777215.0);
      result = vec4(far >> 16, far >> 8 & 255, far & 255, 255) / 255.0;
    }
  }`;
