"""What cannot run where it was: lost computers, crashes, too little room."""
