use std::ffi::{c_char, c_int, c_void, CStr};

#[link(name = "coadjoint")]
extern "C" {
    fn coadjoint_message() -> *const c_char;
    fn coadjoint_create(table: *const c_char, length: usize, run: *mut *mut c_void) -> c_int;
    fn coadjoint_destroy(run: *mut c_void);
    fn coadjoint_set_state(run: *mut c_void, x: *const f64, size: usize) -> c_int;
    fn coadjoint_save(run: *mut c_void, points: i64, every: i64, saved: *mut f64, capacity: usize) -> c_int;
}

fn check(code: c_int) -> Result<(), String> {
    if code == 0 {
        return Ok(());
    }
    Err(unsafe { CStr::from_ptr(coadjoint_message()) }.to_string_lossy().into_owned())
}

struct Run(*mut c_void);

impl Run {
    fn new(table: &str) -> Result<Run, String> {
        let mut run = std::ptr::null_mut();
        check(unsafe { coadjoint_create(table.as_ptr().cast(), table.len(), &mut run) })?;
        Ok(Run(run))
    }
    fn start(&mut self, x: &[f64]) -> Result<(), String> {
        check(unsafe { coadjoint_set_state(self.0, x.as_ptr(), x.len()) })
    }
    fn save(&mut self, points: i64, every: i64, saved: &mut [f64]) -> Result<(), String> {
        check(unsafe { coadjoint_save(self.0, points, every, saved.as_mut_ptr(), saved.len()) })
    }
}

impl Drop for Run {
    fn drop(&mut self) {
        unsafe { coadjoint_destroy(self.0) }
    }
}

unsafe impl Send for Run {} // not Sync: one thread at a time

fn main() -> Result<(), String> {
    let mut run = Run::new(&std::fs::read_to_string("top.json").map_err(|e| e.to_string())?)?;
    let mut saved = [0.0; 60];
    run.start(&[0.3, 0.2, 1.0, 0.6, 0.0, 0.8])?;
    run.save(10, 100, &mut saved)?;
    println!("{} {}", saved[54], saved[55]);
    Ok(())
}
