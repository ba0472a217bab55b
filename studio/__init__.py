"""Pages for people: reports, and the studio, a local application in the browser."""
