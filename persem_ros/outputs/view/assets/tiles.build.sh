#!/bin/sh
# Makes tiles.min.js: three.js and NASA-AMMOS' 3D Tiles renderer, what view.js uses of them. Needs npm.
set -e
three=0.187.0
tiles=0.5.3
here=$(cd "$(dirname "$0")" && pwd)
work=$(mktemp -d)
cd "$work"
npm install --no-save --legacy-peer-deps three@$three 3d-tiles-renderer@$tiles esbuild@0.28.2
cat > entry.js <<'JS'
export {
  BufferAttribute, BufferGeometry, DataTexture, GLSL3, Group, Line, LineBasicMaterial,
  LineSegments, Matrix3, PerspectiveCamera, RawShaderMaterial, Scene, Vector2, Vector3,
  WebGLRenderer, WebGLRenderTarget,
} from 'three';
export { OrbitControls } from 'three/examples/jsm/controls/OrbitControls.js';
export { TilesRenderer } from '3d-tiles-renderer/three';
JS
npx esbuild entry.js --bundle --minify --format=iife --global-name=TILES --charset=ascii \
  --legal-comments=none --outfile="$here/tiles.min.js" \
  --banner:js="/* three.js $three, MIT licence, copyright three.js authors (three.LICENSE); 3d-tiles-renderer $tiles, Apache-2.0, copyright California Institute of Technology (3d-tiles-renderer.LICENSE); made by tiles.build.sh */"
cp node_modules/three/LICENSE "$here/three.LICENSE"
cp node_modules/3d-tiles-renderer/LICENSE "$here/3d-tiles-renderer.LICENSE"
rm -r "$work"
