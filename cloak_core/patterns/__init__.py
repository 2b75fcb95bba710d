"""What can be worn, a file each: colours of faces, groups of faces, a cloth, a picture on the chest, the controls."""
