#!/bin/sh
# Makes three.min.js: the parts of three.js that viewer.js uses, in one file. Needs npm.
set -e
version=0.187.0
here=$(cd "$(dirname "$0")" && pwd)
work=$(mktemp -d)
cd "$work"
npm install --no-save three@$version esbuild@0.28.2
cat > entry.js <<'END'
export {
  BufferAttribute, BufferGeometry, DataTexture, GLSL3, Line, LineBasicMaterial, Matrix3,
  PerspectiveCamera, Points, RawShaderMaterial, Scene, Vector2, Vector3, WebGLRenderer,
} from 'three';
export { OrbitControls } from 'three/examples/jsm/controls/OrbitControls.js';
END
npx esbuild entry.js --bundle --minify --format=iife --global-name=THREE --charset=ascii \
  --legal-comments=none --outfile="$here/three.min.js" \
  --banner:js="/* three.js $version, MIT licence, copyright three.js authors (three.LICENSE); made by three.build.sh */"
cp node_modules/three/LICENSE "$here/three.LICENSE"
rm -r "$work"
