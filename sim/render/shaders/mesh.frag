#version 330 core
// Flat Lambert luminance, linear (no gamma), as the sample word that sim/render/lattice.py adds up.

flat in uint word;
out uint frag_word;

void main()
{
    frag_word = word;
}
